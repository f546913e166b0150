//! A network camera that sends JPEG after JPEG (`multipart/x-mixed-replace` over HTTP), read as they come.
//!
//! OpenCV reads such streams too, but hands on what waited in its buffers without a word of how long it lay there. Here
//! a picture is known the moment its last byte is there, before it is decoded.

use crate::error::{Error, Result};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use hyper::body::{Body, Incoming};
use hyper::client::conn::http1::{SendRequest, handshake};
use hyper::header::{ACCEPT, AUTHORIZATION, CONTENT_TYPE, HOST};
use hyper::{Request, Response, Uri};
use hyper_util::rt::TokioIo;
use std::future::poll_fn;
use std::pin::Pin;
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::runtime::{Builder, Runtime};
use tokio::time::timeout;

/// How long the answer, and then each next piece of it, may take.
const OPEN_TIMEOUT: Duration = Duration::from_secs(3);
const READ_TIMEOUT: Duration = Duration::from_secs(1);
const KIND: &str = "multipart/x-mixed-replace";
/// A picture is not larger, nor the lines before it, bytes.
const MOST_PICTURE: usize = 64 << 20;
const MOST_HEAD: usize = 16 << 10;

/// An open stream.
#[derive(Debug)]
pub struct MotionJpeg {
    runtime: Runtime,
    body: Incoming,
    parts: Parts,
    /// The connection lives as long as this does.
    _sender: SendRequest<String>,
}

impl MotionJpeg {
    /// Asks for the stream at an address. `None` where the address or what answers there is of another kind.
    ///
    /// # Errors
    /// A server that is not there, does not answer in three seconds, or refuses.
    pub fn open(address: &str) -> Result<Option<Self>> {
        let Some(address) = address.parse::<Uri>().ok().filter(|address| address.scheme_str() == Some("http")) else {
            return Ok(None);
        };
        let failed =
            |why: String| Error::Domain(format!("the stream at {}: {why}", address.host().unwrap_or_default()));
        let runtime = Builder::new_current_thread().enable_all().build().map_err(|e| failed(e.to_string()))?;
        let (sender, response) = runtime
            .block_on(async { timeout(OPEN_TIMEOUT, ask(&address)).await })
            .map_err(|_| failed("no answer in three seconds".into()))?
            .map_err(failed)?;
        let (head, body) = response.into_parts();
        if head.status.is_client_error() || head.status.is_server_error() {
            return Err(failed(format!("the answer is {}", head.status)));
        }
        let kind = head.headers.get(CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or_default();
        let Some(parts) = Parts::of(kind) else { return Ok(None) };
        Ok(Some(Self { runtime, body, parts, _sender: sender }))
    }

    /// The next JPEG, waited for; `None` where the camera is gone, silent for a second, or sends something else.
    pub fn read(&mut self) -> Option<Vec<u8>> {
        loop {
            match self.parts.take() {
                Taken::Picture(jpeg) => return Some(jpeg),
                Taken::Broken => return None,
                Taken::NotYet => {}
            }
            let piece = poll_fn(|context| Pin::new(&mut self.body).poll_frame(context));
            let piece = self.runtime.block_on(async { timeout(READ_TIMEOUT, piece).await }).ok()??.ok()?;
            if let Ok(bytes) = piece.into_data() {
                self.parts.pending.extend_from_slice(&bytes);
            }
        }
    }
}

async fn ask(address: &Uri) -> std::result::Result<(SendRequest<String>, Response<Incoming>), String> {
    let authority = address.authority().map_or("", |authority| authority.as_str());
    let (login, host) = authority.rsplit_once('@').map_or((None, authority), |(login, host)| (Some(login), host));
    let name = address.host().unwrap_or_default().trim_matches(['[', ']']);
    let stream = TcpStream::connect((name, address.port_u16().unwrap_or(80))).await.map_err(|e| e.to_string())?;
    let (mut sender, connection) = handshake(TokioIo::new(stream)).await.map_err(|e| e.to_string())?;
    tokio::spawn(connection);
    let path = address.path_and_query().map_or("/", |path| path.as_str());
    let mut request = Request::get(path).header(HOST, host).header(ACCEPT, KIND);
    if let Some(login) = login {
        request = request.header(AUTHORIZATION, format!("Basic {}", BASE64_STANDARD.encode(login)));
    }
    let request = request.body(String::new()).map_err(|e| e.to_string())?;
    let response = sender.send_request(request).await.map_err(|e| e.to_string())?;
    Ok((sender, response))
}

/// Takes pictures out of the bytes that came.
#[derive(Debug)]
struct Parts {
    /// What stands before each part.
    delimiter: Vec<u8>,
    pending: Vec<u8>,
}

enum Taken {
    Picture(Vec<u8>),
    NotYet,
    Broken,
}

impl Parts {
    /// By the answer's content type; `None` where it has no parts.
    fn of(kind: &str) -> Option<Self> {
        let mut words = kind.split(';').map(str::trim);
        if !words.next()?.eq_ignore_ascii_case(KIND) {
            return None;
        }
        let boundary = words.find_map(|word| {
            let (name, value) = word.split_once('=')?;
            name.eq_ignore_ascii_case("boundary").then(|| value.trim_matches('"'))
        })?;
        // Many cameras count the dashes before it to its name.
        Some(Self { delimiter: format!("--{}", boundary.trim_start_matches('-')).into_bytes(), pending: Vec::new() })
    }

    fn take(&mut self) -> Taken {
        loop {
            let Some(head_end) = find(&self.pending, b"\r\n\r\n") else {
                return if self.pending.len() > MOST_HEAD { Taken::Broken } else { Taken::NotYet };
            };
            let body = head_end + 4;
            if find(&self.pending[..head_end], &self.delimiter).is_none() {
                // Empty lines between the parts.
                self.pending.drain(..body);
                continue;
            }
            let end = match content_length(&self.pending[..head_end]) {
                Some(length) => body.saturating_add(length),
                None => match find(&self.pending[body..], &[b"\r\n", &self.delimiter[..]].concat()) {
                    Some(length) => body + length,
                    None if self.pending.len() > MOST_PICTURE => return Taken::Broken,
                    None => return Taken::NotYet,
                },
            };
            if end > MOST_PICTURE {
                return Taken::Broken;
            }
            if self.pending.len() < end {
                return Taken::NotYet;
            }
            let picture = self.pending[body..end].to_vec();
            self.pending.drain(..end);
            return Taken::Picture(picture);
        }
    }
}

fn content_length(head: &[u8]) -> Option<usize> {
    String::from_utf8_lossy(head).lines().find_map(|line| {
        let (name, value) = line.split_once(':')?;
        if name.trim().eq_ignore_ascii_case("content-length") { value.trim().parse().ok() } else { None }
    })
}

fn find(bytes: &[u8], wanted: &[u8]) -> Option<usize> {
    bytes.windows(wanted.len()).position(|window| window == wanted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::{Read, Write};

    /// All pictures of a stream that comes in pieces of these lengths, over and over.
    fn pictures(kind: &str, stream: &[u8], pieces: &[usize]) -> Vec<Vec<u8>> {
        let mut parts = Parts::of(kind).unwrap();
        let (mut found, mut at, mut pieces) = (Vec::new(), 0, pieces.iter().cycle());
        while at < stream.len() {
            let end = stream.len().min(at + pieces.next().unwrap());
            parts.pending.extend_from_slice(&stream[at..end]);
            at = end;
            while let Taken::Picture(picture) = parts.take() {
                found.push(picture);
            }
        }
        found
    }

    proptest! {
        #[test]
        fn pictures_are_taken_out_however_the_bytes_come(
            sent in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..300), 1..6),
            pieces in proptest::collection::vec(1usize..200, 1..8),
            (with_length, dashes, blank) in any::<(bool, bool, bool)>(),
        ) {
            let boundary = if dashes { "--frame" } else { "frame" };
            let mut stream = Vec::new();
            for picture in &sent {
                stream.extend(b"--frame\r\nContent-Type: image/jpeg\r\n");
                if with_length {
                    stream.extend(format!("CONTENT-LENGTH: {}\r\n", picture.len()).into_bytes());
                }
                stream.extend([b"\r\n", &picture[..], b"\r\n"].concat());
                if blank && with_length {
                    stream.extend(b"\r\n");
                }
            }
            stream.extend(b"--frame");
            let kind = format!("Multipart/X-Mixed-Replace; charset=x; boundary=\"{boundary}\"");
            prop_assert_eq!(pictures(&kind, &stream, &pieces), sent);
        }

        #[test]
        fn any_bytes_are_borne(bytes in proptest::collection::vec(any::<u8>(), 0..2000)) {
            pictures("multipart/x-mixed-replace;boundary=a", &bytes, &[100]);
            pictures("multipart/x-mixed-replace;boundary=a", &[b"--a\r\n\r\n", &bytes[..]].concat(), &[100]);
        }
    }

    /// A server that answers one request with this, and gives what it was asked.
    fn server(answer: &'static [u8]) -> (std::net::SocketAddr, std::thread::JoinHandle<String>) {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let asked = std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let mut asked = [0; 1000];
            let length = stream.read(&mut asked).unwrap();
            stream.write_all(answer).unwrap();
            String::from_utf8_lossy(&asked[..length]).into_owned()
        });
        (address, asked)
    }

    #[test]
    fn a_camera_that_wants_a_password_and_sends_in_chunks_is_read() {
        let (address, asked) = server(
            b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace;boundary=a\r\nTransfer-Encoding: chunked\r\n\r\n\
              7\r\n--a\r\nCo\r\n18\r\nntent-Length: 3\r\n\r\none\r\n\r\n11\r\n--a\r\n\r\ntwo\r\n--a\r\n\r\n0\r\n\r\n",
        );
        let mut stream = MotionJpeg::open(&format!("http://me:secret@{address}/live?x=1")).unwrap().unwrap();
        assert_eq!([stream.read(), stream.read(), stream.read()], [Some(b"one".to_vec()), Some(b"two".to_vec()), None]);
        let asked = asked.join().unwrap().to_lowercase();
        assert!(asked.starts_with("get /live?x=1 http/1.1\r\n") && asked.contains(&format!("host: {address}\r\n")));
        assert!(asked.contains("authorization: basic bwu6c2vjcmv0\r\n"), "{asked}");
    }

    #[test]
    fn what_is_no_stream_of_jpegs_is_left_to_others_and_a_refusal_told() {
        assert!(MotionJpeg::open("rtsp://camera/1").unwrap().is_none());
        let (address, _) = server(b"HTTP/1.1 200 OK\r\nContent-Type: video/mp4\r\nContent-Length: 0\r\n\r\n");
        assert!(MotionJpeg::open(&format!("http://{address}/")).unwrap().is_none());
        let (address, _) = server(b"HTTP/1.1 401 Unauthorized\r\nContent-Length: 0\r\n\r\n");
        let message = MotionJpeg::open(&format!("http://{address}/")).unwrap_err().to_string();
        assert!(message.contains("127.0.0.1: the answer is 401"), "{message}");
    }

    #[test]
    fn what_has_no_parts_or_no_end_is_refused() {
        assert!(Parts::of("video/mp4").is_none() && Parts::of(KIND).is_none());
        let mut parts = Parts::of("multipart/x-mixed-replace;boundary=a").unwrap();
        parts.pending = vec![b'x'; MOST_HEAD + 1];
        assert!(matches!(parts.take(), Taken::Broken));
        parts.pending = b"--a\r\nContent-Length: 99999999999\r\n\r\n".to_vec();
        assert!(matches!(parts.take(), Taken::Broken));
    }
}
