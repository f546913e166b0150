//! A network camera that sends JPEG after JPEG (`multipart/x-mixed-replace` over HTTP), read as they come.
//!
//! OpenCV reads such streams too, but hands on frames that waited in its buffers without telling for how long. Here the time of
//! arrival is that of the picture's last byte, before it is decoded.

use super::multipart::{CONTENT_KIND, MultipartParser, Part};
use super::stream::{Came, FrameStream, Packed, SentFrame};
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
use std::time::{Duration, Instant};
use tokio::net::TcpStream;
use tokio::runtime::{Builder, Runtime};
use tokio::time::timeout;

/// Time in which the server must answer. Convention.
///
/// Convention: a timeout.
const OPEN_TIMEOUT: Duration = Duration::from_secs(3);
/// Time in which each next piece of the answer must arrive. Convention.
///
/// Convention: a timeout.
const READ_TIMEOUT: Duration = Duration::from_secs(1);

/// Time in which each next picture must be there, however its pieces trickle in. Convention.
///
/// Convention: a timeout.
const PICTURE_TIMEOUT: Duration = Duration::from_secs(5);
/// Time between two looks at whether to go on. Convention.
///
/// Convention: a timeout.
const POLL: Duration = Duration::from_millis(100);

/// An open stream.
#[derive(Debug)]
pub struct MotionJpeg {
    runtime: Runtime,
    body: Incoming,
    parts: MultipartParser,
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
        let failed = |message: String| Error::Unavailable {
            what: format!("the stream at {}", address.host().unwrap_or_default()),
            message,
        };
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
        let Some(parts) = MultipartParser::new(kind) else { return Ok(None) };
        Ok(Some(Self { runtime, body, parts, _sender: sender }))
    }

    /// The next JPEG, waited for while `goes_on` says so; `None` where the camera is gone, silent for a second, takes more than five for
    /// a picture, or sends something else.
    pub fn read(&mut self, goes_on: impl Fn() -> bool) -> Option<Vec<u8>> {
        let began = Instant::now();
        let mut heard = began;
        while goes_on() {
            match self.parts.next_part() {
                Part::Complete(jpeg) => return Some(jpeg),
                Part::Broken => return None,
                Part::Incomplete => {}
            }
            let piece = poll_fn(|context| Pin::new(&mut self.body).poll_frame(context));
            match self.runtime.block_on(async { timeout(POLL, piece).await }) {
                Ok(piece) => {
                    if let Ok(bytes) = piece?.ok()?.into_data() {
                        self.parts.push(&bytes);
                    }
                    heard = Instant::now();
                }
                Err(_) if heard.elapsed() > READ_TIMEOUT => return None,
                Err(_) => {}
            }
            if began.elapsed() > PICTURE_TIMEOUT {
                return None;
            }
        }
        None
    }
}

impl FrameStream for MotionJpeg {
    fn next(&mut self, goes_on: &dyn Fn() -> bool) -> Option<Came<SentFrame>> {
        self.read(goes_on).map(|jpeg| Came::One(SentFrame { packed: Packed::File(jpeg), stamp_s: None }))
    }

    fn trouble(&self) -> String {
        "no more frames come; trying again".into()
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
    let mut request = Request::get(path).header(HOST, host).header(ACCEPT, CONTENT_KIND);
    if let Some(login) = login {
        request = request.header(AUTHORIZATION, format!("Basic {}", BASE64_STANDARD.encode(login)));
    }
    let request = request.body(String::new()).map_err(|e| e.to_string())?;
    let response = sender.send_request(request).await.map_err(|e| e.to_string())?;
    Ok((sender, response))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read, Write};

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
        let mut read = || stream.read(|| true);
        assert_eq!([read(), read(), read()], [Some(b"one".to_vec()), Some(b"two".to_vec()), None]);
        let asked = asked.join().unwrap().to_lowercase();
        assert!(asked.starts_with("get /live?x=1 http/1.1\r\n") && asked.contains(&format!("host: {address}\r\n")));
        assert!(asked.contains("authorization: basic bwu6c2vjcmv0\r\n"), "{asked}");
    }

    #[test]
    fn a_camera_that_trickles_is_given_up_and_left_at_once_when_nobody_goes_on() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                std::thread::spawn(move || {
                    let mut stream = stream.unwrap();
                    let _ = stream.read(&mut [0; 1000]);
                    let head =
                        b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace;boundary=a\r\n\r\n--a\r\n\r\n";
                    let mut sent = stream.write_all(head);
                    while sent.is_ok() {
                        std::thread::sleep(Duration::from_millis(20));
                        sent = stream.write_all(b"x");
                    }
                });
            }
        });
        let open = || MotionJpeg::open(&format!("http://{address}/")).unwrap().unwrap();
        let (mut stream, began) = (open(), Instant::now());
        assert_eq!(stream.read(|| began.elapsed() < Duration::from_millis(300)), None);
        assert!(began.elapsed() < Duration::from_secs(1), "{:?}", began.elapsed());
        let (mut stream, began) = (open(), Instant::now());
        assert_eq!(stream.read(|| true), None);
        assert!((5.0..6.5).contains(&began.elapsed().as_secs_f64()), "{:?}", began.elapsed());
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
}
