//! Who may see a page, and who may press its buttons.
//!
//! - A page that other machines can reach is for those who know its token.
//! - A page on loopback has no token unless one is given. Other web sites in the same browser must not reach it: a name of
//!   theirs that suddenly means 127.0.0.1 (DNS rebinding) shows in `Host`, a request from their pages in `Origin`.
//! - Whatever changes something is sent as JSON, which a form of another site cannot do.

use std::net::IpAddr;

use hyper::header::{AUTHORIZATION, CONTENT_TYPE, HOST, HeaderMap, HeaderName, ORIGIN};
use hyper::{Method, StatusCode, Uri};
use sha2::{Digest, Sha256};
use thiserror::Error;

use crate::scenario::hex;

/// Letters of a token that is given.
const LENGTHS: std::ops::RangeInclusive<usize> = 16..=128;

/// A token cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("a token has {} to {} letters a–z, A–Z, digits, - and _; this one has {length}{other}", LENGTHS.start(), LENGTHS.end())]
pub struct TokenError {
    length: usize,
    other: &'static str,
}

/// What is let in.
#[derive(Clone)]
pub struct Guard {
    token: Option<String>,
    /// Names are checked: the page is on loopback.
    loopback: bool,
}

impl std::fmt::Debug for Guard {
    /// Without the token.
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "Guard {{ token: {}, loopback: {} }}", self.token.is_some(), self.loopback)
    }
}

/// A token that nobody guesses.
pub fn random_token() -> String {
    hex(&rand::random::<u128>().to_be_bytes())
}

/// Why a request is refused.
pub type Refusal = (StatusCode, &'static str);

impl Guard {
    /// The guard of an address; one that is not loopback gets a random token if there is none.
    ///
    /// # Errors
    /// [`TokenError`].
    pub fn new(address: IpAddr, token: Option<String>) -> Result<Self, TokenError> {
        if let Some(token) = &token {
            let plain = token.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_');
            let length = token.chars().count();
            if !plain || !LENGTHS.contains(&length) {
                let other = if plain { "" } else { ", others among them" };
                return Err(TokenError { length, other });
            }
        }
        let loopback = address.is_loopback();
        let random = || (!loopback).then(random_token);
        Ok(Guard { token: token.or_else(random), loopback })
    }

    /// The token, if one is needed.
    pub fn token(&self) -> Option<&str> {
        self.token.as_deref()
    }

    /// Whether a request is let in.
    ///
    /// # Errors
    /// The answer that it gets otherwise.
    pub fn admit(&self, method: &Method, uri: &Uri, headers: &HeaderMap) -> Result<(), Refusal> {
        if self.loopback && !text(headers, HOST).is_some_and(is_loopback_name) {
            return Err((StatusCode::FORBIDDEN, "this page is on loopback: open it as 127.0.0.1 or localhost"));
        }
        if let Some(token) = &self.token {
            let Some(given) = given_token(uri, headers) else {
                return Err((StatusCode::UNAUTHORIZED, "a token is needed: open the address that the run printed"));
            };
            if !same(given, token) {
                return Err((StatusCode::FORBIDDEN, "the token is not that of this run"));
            }
        }
        if method == Method::POST {
            let own = text(headers, HOST).map(|host| format!("http://{host}"));
            if text(headers, ORIGIN).is_some_and(|origin| own.as_deref() != Some(origin)) {
                return Err((StatusCode::FORBIDDEN, "another site's page may not do this"));
            }
            let from = text(headers, HeaderName::from_static("sec-fetch-site"));
            if from.is_some_and(|from| !["same-origin", "none"].contains(&from)) {
                return Err((StatusCode::FORBIDDEN, "another site's page may not do this"));
            }
            let kind = text(headers, CONTENT_TYPE).unwrap_or_default();
            if kind.split(';').next().map(str::trim) != Some("application/json") {
                return Err((StatusCode::UNSUPPORTED_MEDIA_TYPE, "send application/json"));
            }
        }
        Ok(())
    }
}

fn text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

/// Whether a `Host` is this machine, whatever the port: it may be passed on from another one.
fn is_loopback_name(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split_once(']').map_or("", |(name, _)| name),
        None => host.split_once(':').map_or(host, |(name, _)| name),
    };
    name.eq_ignore_ascii_case("localhost") || name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

/// The token of a request: from its head, or in its address, for the first one.
fn given_token<'a>(uri: &'a Uri, headers: &'a HeaderMap) -> Option<&'a str> {
    let bearer = text(headers, AUTHORIZATION).and_then(|given| given.strip_prefix("Bearer "));
    let query = || uri.query()?.split('&').find_map(|pair| pair.strip_prefix("token="));
    bearer.or_else(query)
}

/// Whether two tokens are the same. Hashes are compared: the time that this takes says nothing of the token.
fn same(given: &str, token: &str) -> bool {
    Sha256::digest(given.as_bytes()) == Sha256::digest(token.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOKEN: &str = "0123456789abcdef";

    fn admit(guard: &Guard, method: Method, uri: &str, heads: &[(&'static str, &str)]) -> u16 {
        let mut headers = HeaderMap::new();
        for (name, value) in heads {
            headers.insert(*name, value.parse().unwrap());
        }
        guard.admit(&method, &uri.parse().unwrap(), &headers).map_or_else(|refusal| refusal.0.as_u16(), |()| 200)
    }

    #[test]
    fn loopback_is_for_this_machine_by_name() {
        let guard = Guard::new("127.0.0.1".parse().unwrap(), None).unwrap();
        assert_eq!(guard.token(), None);
        for (host, code) in [
            ("127.0.0.1:8080", 200),
            ("localhost:8080", 200),
            ("LOCALHOST", 200),
            ("[::1]:80", 200),
            ("evil.example:8080", 403),
            ("127.0.0.1.evil.example", 403),
            ("localhost.evil.example:8080", 403),
            ("[::2]", 403),
            ("", 403),
        ] {
            assert_eq!(admit(&guard, Method::GET, "/now", &[("host", host)]), code, "{host}");
        }
        assert_eq!(admit(&guard, Method::GET, "/now", &[]), 403, "without a host");
    }

    #[test]
    fn other_sites_cannot_press_buttons() {
        let guard = Guard::new("::1".parse().unwrap(), None).unwrap();
        let post = |more: &[(&'static str, &str)]| {
            let heads = [&[("host", "localhost:80"), ("content-type", "application/json")], more].concat();
            admit(&guard, Method::POST, "/stop", &heads)
        };
        assert_eq!(post(&[]), 200);
        assert_eq!(post(&[("origin", "http://localhost:80"), ("sec-fetch-site", "same-origin")]), 200);
        assert_eq!(post(&[("origin", "http://evil.example")]), 403);
        assert_eq!(post(&[("origin", "null")]), 403);
        assert_eq!(post(&[("sec-fetch-site", "cross-site")]), 403);
        assert_eq!(post(&[("content-type", "text/plain")]), 415);
    }

    #[test]
    fn other_machines_need_the_token() {
        let guard = Guard::new("0.0.0.0".parse().unwrap(), Some(TOKEN.to_owned())).unwrap();
        let host = ("host", "robot.lan:8080");
        assert_eq!(admit(&guard, Method::GET, "/", &[host]), 401);
        assert_eq!(admit(&guard, Method::GET, "/?token=0123456789abcdee", &[host]), 403);
        assert_eq!(admit(&guard, Method::GET, "/?token=", &[host]), 403);
        assert_eq!(admit(&guard, Method::GET, "/?a=b&token=0123456789abcdef", &[host]), 200);
        assert_eq!(admit(&guard, Method::GET, "/now", &[host, ("authorization", "Bearer 0123456789abcdef")]), 200);
        assert_eq!(admit(&guard, Method::GET, "/now", &[host, ("authorization", "Bearer 0")]), 403);
        assert!(!format!("{guard:?}").contains(TOKEN));
    }

    #[test]
    fn tokens_are_random_where_none_is_given_and_never_weak() {
        let open = || Guard::new("192.168.0.1".parse().unwrap(), None).unwrap();
        let (a, b) = (open(), open());
        assert!(a.token().unwrap().len() == 32 && a.token() != b.token());
        for weak in ["", "short", "0123456789abcde", "0123456789abcdef&", "0123456789 bcdef"] {
            let error = Guard::new("0.0.0.0".parse().unwrap(), Some(weak.to_owned())).unwrap_err();
            assert!(error.to_string().contains("16 to 128"), "{error}");
        }
        let own = Guard::new("127.0.0.1".parse().unwrap(), Some(TOKEN.to_owned())).unwrap();
        assert_eq!(own.token(), Some(TOKEN), "on loopback, too");
    }
}
