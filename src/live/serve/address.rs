//! The address of a page, as people write it.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use thiserror::Error;

/// A text is no address.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error(
    "it is no address: give a port (8080), an address (192.168.1.5) or both (127.0.0.1:8080); SCENARIO comes before --serve"
)]
pub struct AddressError;

/// An address from `8080`, `127.0.0.1`, `127.0.0.1:8080`, `[::1]:8080` or `localhost:8080`; what is missing is loopback, and
/// any port that is free.
///
/// # Errors
/// [`AddressError`].
pub fn parse_address(text: &str) -> Result<SocketAddr, AddressError> {
    let loopback = IpAddr::V4(Ipv4Addr::LOCALHOST);
    let text = text.trim();
    if let Some(rest) = text.strip_prefix("localhost") {
        let port = if rest.is_empty() { Some(0) } else { rest.strip_prefix(':').and_then(|port| port.parse().ok()) };
        return port.map(|port| SocketAddr::new(loopback, port)).ok_or(AddressError);
    }
    if let Ok(port) = text.strip_prefix(':').unwrap_or(text).parse() {
        return Ok(SocketAddr::new(loopback, port));
    }
    let bare = text.strip_prefix('[').and_then(|text| text.strip_suffix(']')).unwrap_or(text);
    if let Ok(address) = bare.parse() {
        return Ok(SocketAddr::new(address, 0));
    }
    text.parse().map_err(|_| AddressError)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_is_loopback_and_a_free_port() {
        let cases = [
            ("8080", "127.0.0.1:8080"),
            (":8080", "127.0.0.1:8080"),
            ("localhost", "127.0.0.1:0"),
            ("localhost:1", "127.0.0.1:1"),
            ("0.0.0.0", "0.0.0.0:0"),
            ("192.168.1.5:80", "192.168.1.5:80"),
            ("::1", "[::1]:0"),
            ("[::1]:8080", "[::1]:8080"),
        ];
        for (text, expected) in cases {
            assert_eq!(parse_address(text).unwrap().to_string(), expected, "{text}");
        }
        for text in ["", "scenarios/lab.toml", "70000", "localhosts", "localhost:x", "1.2.3:4", "example.org:80"] {
            assert_eq!(parse_address(text), Err(AddressError), "{text}");
        }
    }
}
