//! The page itself: one text that loads nothing but the run's own numbers.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use sha2::{Digest, Sha256};

const HTML: &str = include_str!("page/page.html");
const STYLE: &str = include_str!("page/page.css");
const SCRIPT: &str = include_str!("page/page.js");

/// The page, and what a browser may do with it.
pub struct Page {
    /// The page, which lives as long as the program.
    pub html: &'static str,
    /// Its Content-Security-Policy: this style, this script, images inside of data, and its own server.
    pub policy: String,
}

impl Page {
    /// Put the parts together.
    pub fn new() -> Self {
        use std::sync::OnceLock;
        static WHOLE: OnceLock<String> = OnceLock::new();
        let html = WHOLE.get_or_init(|| HTML.replace("/*STYLE*/", STYLE).replace("/*SCRIPT*/", SCRIPT));
        let hash = |text: &str| format!("'sha256-{}'", STANDARD.encode(Sha256::digest(text.as_bytes())));
        let policy = format!(
            "default-src 'none'; script-src {}; style-src {}; img-src data:; connect-src 'self'; base-uri 'none'; \
             form-action 'none'; frame-ancestors 'none'",
            hash(SCRIPT),
            hash(STYLE)
        );
        Page { html, policy }
    }
}
