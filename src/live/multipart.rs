//! Takes the parts of a `multipart/x-mixed-replace` stream out of its bytes as they arrive. Does no reading itself.

/// The content type of such streams.
pub const CONTENT_KIND: &str = "multipart/x-mixed-replace";
/// Longest picture, bytes. Convention: a resource limit.
const MAX_PICTURE: usize = 64 << 20;
/// Longest head of a part, bytes. Convention: a resource limit.
const MAX_HEAD: usize = 16 << 10;
/// What ends a part's head.
///
/// Source: RFC 2046, section 5.1.
const HEAD_END: &[u8] = b"\r\n\r\n";

/// The bytes that have arrived and were not taken yet.
#[derive(Debug)]
pub struct MultipartParser {
    /// What stands after each part's content: the end of a line, and what stands before the next part.
    delimiter: Vec<u8>,
    pending: Vec<u8>,
    /// Whether the first delimiter was met. What precedes it is a preamble and no part (RFC 2046, section 5.1.1): some cameras begin with a whole
    /// picture and put a delimiter behind each.
    has_begun: bool,
    /// The part whose head was taken: its length, where that was told.
    open: Option<Option<usize>>,
    /// So many of the pending bytes were searched in vain.
    searched: usize,
}

/// What the bytes so far hold.
#[derive(Debug, PartialEq, Eq)]
pub enum Part {
    /// A part's content.
    Complete(Vec<u8>),
    /// No whole part yet: more bytes are needed.
    Incomplete,
    /// Something that is no such stream, or a part that is too long.
    Broken,
}

impl MultipartParser {
    /// A parser for an answer of this content type; `None` where that has no parts.
    pub fn new(content_type: &str) -> Option<Self> {
        let mut words = content_type.split(';').map(str::trim);
        if !words.next()?.eq_ignore_ascii_case(CONTENT_KIND) {
            return None;
        }
        let boundary = words.find_map(|word| {
            let (name, value) = word.split_once('=')?;
            name.eq_ignore_ascii_case("boundary").then(|| value.trim_matches('"'))
        })?;
        // Many cameras take the dashes before the boundary for part of its name.
        let delimiter = format!("\r\n--{}", boundary.trim_start_matches('-')).into_bytes();
        Some(Self { delimiter, pending: Vec::new(), has_begun: false, open: None, searched: 0 })
    }

    /// Takes the next bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.pending.extend_from_slice(bytes);
    }

    /// The next part. Every byte is searched once, however many pieces it comes in.
    pub fn next_part(&mut self) -> Part {
        loop {
            if !self.has_begun && !self.passes_preamble() {
                return if self.pending.len() > MAX_PICTURE { Part::Broken } else { Part::Incomplete };
            }
            let end = match self.open {
                None => {
                    let Some(end) = self.find(HEAD_END) else {
                        return if self.pending.len() > MAX_HEAD { Part::Broken } else { Part::Incomplete };
                    };
                    let head = self.take(end + HEAD_END.len());
                    // The first delimiter need not begin a line. Without one these are empty lines between the parts.
                    if find(&head, &self.delimiter[2..]).is_some() {
                        self.open = Some(content_length(&head));
                    }
                    continue;
                }
                Some(Some(length)) if length > MAX_PICTURE => return Part::Broken,
                Some(Some(length)) => length,
                Some(None) => match self.find(&self.delimiter.clone()) {
                    Some(end) => end,
                    None if self.pending.len() > MAX_PICTURE => return Part::Broken,
                    None => return Part::Incomplete,
                },
            };
            if self.pending.len() < end {
                return Part::Incomplete;
            }
            self.open = None;
            return Part::Complete(self.take(end));
        }
    }

    /// Takes what precedes the first delimiter, which need not begin a line. Whether the delimiter is there.
    fn passes_preamble(&mut self) -> bool {
        let first = self.delimiter[2..].to_vec();
        if let Some(at) = self.find(&first) {
            self.take(at);
            self.has_begun = true;
        }
        self.has_begun
    }

    /// Where something stands in the pending bytes, of which those searched before are passed over.
    fn find(&mut self, wanted: &[u8]) -> Option<usize> {
        let from = self.searched.saturating_sub(wanted.len() - 1);
        let found = find(&self.pending[from..], wanted).map(|at| from + at);
        self.searched = self.pending.len();
        found
    }

    /// Takes the first pending bytes.
    fn take(&mut self, length: usize) -> Vec<u8> {
        self.searched = 0;
        let rest = self.pending.split_off(length);
        std::mem::replace(&mut self.pending, rest)
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

    /// All pictures of a stream that comes in pieces of these lengths, over and over.
    fn pictures(kind: &str, stream: &[u8], pieces: &[usize]) -> Vec<Vec<u8>> {
        let mut parts = MultipartParser::new(kind).unwrap();
        let (mut found, mut at, mut pieces) = (Vec::new(), 0, pieces.iter().cycle());
        while at < stream.len() {
            let end = stream.len().min(at + pieces.next().unwrap());
            parts.push(&stream[at..end]);
            at = end;
            while let Part::Complete(picture) = parts.next_part() {
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

    #[test]
    fn a_stream_that_begins_with_a_picture_gives_those_behind_its_delimiters() {
        let part = |picture: &str| {
            format!("Content-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n{picture}\r\n--a\r\n", picture.len())
        };
        let long = "x".repeat(3 * MAX_HEAD);
        let stream = [part(&long), part("two"), part("three")].concat();
        let found = pictures("multipart/x-mixed-replace;boundary=a", stream.as_bytes(), &[1000]);
        assert_eq!(found, [b"two".to_vec(), b"three".to_vec()]);
    }

    #[test]
    fn a_large_picture_without_a_length_is_searched_once_however_many_pieces_it_comes_in() {
        let picture = vec![b'-'; 16 << 20];
        let stream = [b"--a\r\n\r\n", &picture[..], b"\r\n--a"].concat();
        let began = std::time::Instant::now();
        let found = pictures("multipart/x-mixed-replace;boundary=a", &stream, &[4096]);
        assert!(found == [picture]);
        // Searched anew for each of its 4096 pieces it would take minutes.
        assert!(began.elapsed() < std::time::Duration::from_secs(2), "{:?}", began.elapsed());
    }

    #[test]
    fn what_has_no_parts_or_no_end_is_refused() {
        assert!(MultipartParser::new("video/mp4").is_none() && MultipartParser::new(CONTENT_KIND).is_none());
        let mut parts = MultipartParser::new("multipart/x-mixed-replace;boundary=a").unwrap();
        parts.push(&vec![b'x'; MAX_PICTURE + 1]);
        assert_eq!(parts.next_part(), Part::Broken);
        let mut parts = MultipartParser::new("multipart/x-mixed-replace;boundary=a").unwrap();
        parts.push(&[b"--a\r\n", &vec![b'x'; MAX_HEAD + 1][..]].concat());
        assert_eq!(parts.next_part(), Part::Broken);
        let mut parts = MultipartParser::new("multipart/x-mixed-replace;boundary=a").unwrap();
        parts.push(b"--a\r\nContent-Length: 99999999999\r\n\r\n");
        assert_eq!(parts.next_part(), Part::Broken);
    }
}
