//! Camera images.

/// An RGB image, 8 bits a channel, row by row from the top.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Image {
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// Whether the upper lines that vision cuts away are missing already, as in images that are rendered for vision alone
    /// ([`Detail::Vision`](crate::scenario::Detail::Vision)).
    pub cropped: bool,
    /// `3 · width · height` bytes.
    pub rgb: Vec<u8>,
}
