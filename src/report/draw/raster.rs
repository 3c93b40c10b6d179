//! SVG texts as PNG files, with letters of a font that is part of this program.

use std::sync::{Arc, OnceLock};

use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree, fontdb};

use super::DrawError;

/// Pixels of an image for each of a drawing, along each side.
const ZOOM: f32 = 2.0;

fn fonts() -> Arc<fontdb::Database> {
    static FONTS: OnceLock<Arc<fontdb::Database>> = OnceLock::new();
    let load = || {
        let mut fonts = fontdb::Database::new();
        fonts.load_font_data(epaint_default_fonts::UBUNTU_LIGHT.to_vec());
        fonts.load_font_data(epaint_default_fonts::HACK_REGULAR.to_vec());
        fonts.set_sans_serif_family("Ubuntu");
        Arc::new(fonts)
    };
    FONTS.get_or_init(load).clone()
}

/// A drawing as a PNG file, twice as large as its pixels.
///
/// # Errors
/// [`DrawError::Raster`]: it is no SVG text, or has no size.
pub fn png(svg: &str) -> Result<Vec<u8>, DrawError> {
    let refused = |cause: &dyn std::fmt::Display| DrawError::Raster(cause.to_string());
    let options = Options { fontdb: fonts(), ..Options::default() };
    let tree = Tree::from_str(svg, &options).map_err(|cause| refused(&cause))?;
    let size = tree.size();
    let (width, height) = ((ZOOM * size.width()).ceil() as u32, (ZOOM * size.height()).ceil() as u32);
    let mut pixels = Pixmap::new(width, height).ok_or_else(|| refused(&format!("{width} × {height} pixels")))?;
    resvg::render(&tree, Transform::from_scale(ZOOM, ZOOM), &mut pixels.as_mut());
    pixels.encode_png().map_err(|cause| refused(&cause))
}
