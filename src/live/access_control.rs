//! Access control of the server: the address, the token, and the checks that every request passes.
//!
//! A web page from elsewhere must not command the robot's loop through its reader's browser. So the `Host` must be an address or a
//! known name (against DNS rebinding), an `Origin` must be the server's own (against cross-site requests), and a server that other
//! machines can reach needs a token as well.

use crate::error::{ArgumentError, Result};
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::header::{AUTHORIZATION, COOKIE, HOST, LOCATION, ORIGIN, SET_COOKIE};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

/// The cookie that holds the token.
const TOKEN_COOKIE: &str = "snakeloop_token";
/// Shorter tokens can be guessed. Convention: 95 bits where letters and digits are random.
const MIN_TOKEN_LENGTH: usize = 16;

/// Where to listen, and whose requests to answer.
#[derive(Debug, Clone)]
pub struct AccessControl {
    address: SocketAddr,
    token: Option<String>,
    names: Vec<String>,
}

impl AccessControl {
    /// Access to a server at an address. `names` are host names, besides addresses and localhost, that the page may be called by.
    ///
    /// # Errors
    /// [`ArgumentError`] for an address beyond loopback without a token, or a token that can be guessed or not be sent.
    pub fn new(address: SocketAddr, token: Option<String>, names: Vec<String>) -> Result<Self> {
        match &token {
            None if !address.ip().is_loopback() => Err(ArgumentError::OpenToAll { address }.into()),
            Some(token) if token.len() < MIN_TOKEN_LENGTH || !token.chars().all(|c| c.is_ascii_alphanumeric()) => {
                Err(ArgumentError::WeakToken { least: MIN_TOKEN_LENGTH }.into())
            }
            _ => Ok(Self { address, token, names }),
        }
    }

    /// The address to listen at.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Whether a `Host` (with or without port) is a name of this server.
    fn is_own_host(&self, host: &str) -> bool {
        let name = match host.rsplit_once(':') {
            Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) => name,
            _ => host,
        };
        let address = name.trim_start_matches('[').trim_end_matches(']');
        address.parse::<IpAddr>().is_ok()
            || name.eq_ignore_ascii_case("localhost")
            || self.names.iter().any(|known| known.eq_ignore_ascii_case(name))
    }

    fn has_token(&self, headers: &HeaderMap) -> bool {
        let Some(token) = &self.token else { return true };
        let text = |name: &HeaderName| headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or_default();
        let in_cookie = || {
            let pairs = text(&COOKIE).split(';').filter_map(|pair| pair.trim().split_once('='));
            pairs.filter(|(name, _)| *name == TOKEN_COOKIE).any(|(_, value)| same_in_constant_time(value, token))
        };
        let bearer = |given: &str| {
            let (scheme, given) = given.split_once(' ')?;
            scheme.eq_ignore_ascii_case("Bearer").then(|| same_in_constant_time(given.trim_start(), token))
        };
        bearer(text(&AUTHORIZATION)).unwrap_or(false) || in_cookie()
    }
}

/// Whether two texts are the same; takes a time that does not tell how much of them is (against timing attacks).
fn same_in_constant_time(a: &str, b: &str) -> bool {
    let differences = a.bytes().zip(b.bytes()).fold(0, |sum, (a, b)| sum | (a ^ b));
    a.len() == b.len() && differences == 0
}

fn refused(status: StatusCode, why: &'static str) -> Response {
    (status, format!("{why}\n")).into_response()
}

/// Lets a request pass, or says why not; adds to every answer what a browser should be told.
pub async fn guard(State(access): State<Arc<AccessControl>>, request: Request, next: Next) -> Response {
    let mut response = match refusal(&access, &request) {
        None => next.run(request).await,
        Some(response) => response,
    };
    let policy =
        "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'; form-action 'none'; base-uri 'none'";
    let told = [
        ("content-security-policy", policy),
        ("x-content-type-options", "nosniff"),
        ("referrer-policy", "no-referrer"),
        ("cross-origin-resource-policy", "same-origin"),
    ];
    for (name, value) in told {
        response.headers_mut().insert(HeaderName::from_static(name), HeaderValue::from_static(value));
    }
    response
}

/// What a request that may not pass is answered instead; `None` for one that may.
fn refusal(access: &AccessControl, request: &Request) -> Option<Response> {
    let headers = request.headers();
    let host = headers.get(HOST).and_then(|host| host.to_str().ok()).unwrap_or_default();
    if headers.get_all(HOST).iter().count() > 1 {
        return Some(refused(StatusCode::BAD_REQUEST, "the request has more than one Host"));
    }
    if !access.is_own_host(host) {
        return Some(refused(
            StatusCode::FORBIDDEN,
            "this name is not known here; call it by its address, or --allow-host",
        ));
    }
    if let Some(origin) = headers.get(ORIGIN) {
        let ours =
            origin.to_str().ok().and_then(|origin| origin.split_once("://")).is_some_and(|(_, from)| from == host);
        if !ours {
            return Some(refused(StatusCode::FORBIDDEN, "requests from other pages are not taken"));
        }
    }
    if access.has_token(headers) {
        return None;
    }
    // The link with the token in it: keep it as a cookie, and take it out of the address.
    let given = request.uri().query().and_then(|query| query.strip_prefix("token="));
    if request.method() == Method::GET
        && request.uri().path() == "/"
        && let (Some(given), Some(token)) = (given, &access.token)
        && same_in_constant_time(given, token)
    {
        let cookie = format!("{TOKEN_COOKIE}={token}; HttpOnly; SameSite=Strict; Path=/");
        let answer = (StatusCode::SEE_OTHER, [(LOCATION, "/".to_owned()), (SET_COOKIE, cookie)], Body::empty());
        return Some(answer.into_response());
    }
    Some(refused(
        StatusCode::UNAUTHORIZED,
        "a token is needed: open /?token=TOKEN, or send Authorization: Bearer TOKEN",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn access(token: Option<&str>) -> AccessControl {
        AccessControl::new("127.0.0.1:8080".parse().unwrap(), token.map(str::to_owned), vec!["bench.lab".into()])
            .unwrap()
    }

    fn status(access: &AccessControl, uri: &str, headers: &[(&str, &str)]) -> u16 {
        let request =
            headers.iter().fold(Request::builder().uri(uri), |request, (name, value)| request.header(*name, *value));
        refusal(access, &request.body(Body::empty()).unwrap()).map_or(200, |refused| refused.status().as_u16())
    }

    #[test]
    fn other_machines_need_a_token() {
        for address in ["0.0.0.0:80", "192.168.1.5:80", "[::]:80"] {
            assert!(AccessControl::new(address.parse().unwrap(), None, vec![]).is_err());
            assert!(AccessControl::new(address.parse().unwrap(), Some("0123456789abcdef".into()), vec![]).is_ok());
        }
        assert!(AccessControl::new("[::1]:80".parse().unwrap(), None, vec![]).is_ok());
        assert!(AccessControl::new("[::1]:80".parse().unwrap(), Some("short".into()), vec![]).is_err());
        assert!(AccessControl::new("[::1]:80".parse().unwrap(), Some("0123456789 abcdef".into()), vec![]).is_err());
    }

    #[test]
    fn names_that_only_lead_here_and_pages_from_elsewhere_are_refused() {
        let access = access(None);
        for host in ["127.0.0.1:8080", "localhost:8080", "[::1]:8080", "[::1]", "10.0.0.3", "Bench.lab:8080"] {
            assert_eq!(status(&access, "/", &[("host", host)]), 200, "{host}");
        }
        for host in ["evil.example:8080", "localhost.evil.example", "", "127.0.0.1.evil.example"] {
            assert_eq!(status(&access, "/", &[("host", host)]), 403, "{host}");
        }
        assert_eq!(status(&access, "/", &[]), 403);
        assert_eq!(status(&access, "/", &[("host", "localhost"), ("host", "evil.example")]), 400);
        let from = |origin| status(&access, "/api/reset", &[("host", "localhost:8080"), ("origin", origin)]);
        assert_eq!(from("http://localhost:8080"), 200);
        for origin in ["http://evil.example", "null", "http://localhost:9999", "http://127.0.0.1:8080"] {
            assert_eq!(from(origin), 403, "{origin}");
        }
    }

    #[test]
    fn a_token_comes_by_header_cookie_or_once_by_link() {
        let access = access(Some("0123456789abcdef"));
        let with = |uri: &str, header: Option<(&str, &str)>| {
            status(&access, uri, &[&[("host", "localhost")], header.as_slice()].concat())
        };
        assert_eq!(with("/api/state", None), 401);
        assert_eq!(with("/api/state", Some(("authorization", "Bearer 0123456789abcdef"))), 200);
        assert_eq!(with("/api/state", Some(("authorization", "bearer  0123456789abcdef"))), 200);
        assert_eq!(with("/api/state", Some(("authorization", "Bearer 0123456789abcdeX"))), 401);
        assert_eq!(with("/api/state", Some(("authorization", "Basic 0123456789abcdef"))), 401);
        assert_eq!(with("/api/state", Some(("cookie", "a=b; snakeloop_token=0123456789abcdef"))), 200);
        assert_eq!(with("/api/state", Some(("cookie", "snakeloop_token="))), 401);
        assert_eq!(with("/?token=0123456789abcdef", None), 303);
        assert_eq!(with("/?token=wrong", None), 401);
        assert_eq!(with("/api/state?token=0123456789abcdef", None), 401);
    }
}
