//! Cuts bytes, as they arrive, into lines. It does no reading itself, so that sockets, growing files and tests share it.

/// The longest line that is taken for a reading, bytes. Convention: a resource limit, some forty times what a reading needs.
pub const MAX_LINE: usize = 4096;

/// The line that has begun and not ended yet.
#[derive(Debug, Default)]
pub struct LineBuffer {
    begun: Vec<u8>,
}

impl LineBuffer {
    /// Takes the next bytes, and gives each line that they end, without its end. Of a line longer than [`MAX_LINE`] one byte more than
    /// that is given, so that it can be told. A last line without an end is not given: digits of it may be missing.
    pub fn push(&mut self, bytes: &[u8], mut each: impl FnMut(&[u8])) {
        for piece in bytes.split_inclusive(|&byte| byte == b'\n') {
            let (text, ended) = piece.strip_suffix(b"\n").map_or((piece, false), |text| (text, true));
            let room = MAX_LINE + 1 - self.begun.len();
            self.begun.extend_from_slice(&text[..text.len().min(room)]);
            if ended {
                each(&self.begun);
                self.begun.clear();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn lines(text: &[u8], piece: usize) -> Vec<Vec<u8>> {
        let (mut buffer, mut lines) = (LineBuffer::default(), Vec::new());
        text.chunks(piece).for_each(|bytes| buffer.push(bytes, |line| lines.push(line.to_vec())));
        lines
    }

    proptest! {
        #[test]
        fn lines_are_the_same_however_the_bytes_arrive(text in "[ab\n]{0,60}", piece in 1usize..20) {
            let mut expected: Vec<&str> = text.split('\n').collect();
            expected.pop();
            prop_assert_eq!(lines(text.as_bytes(), piece), expected.iter().map(|line| line.as_bytes().to_vec()).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_line_without_end_takes_no_more_memory_than_it_may() {
        let text = [&b"short\n"[..], &vec![b'x'; 3 * MAX_LINE], b"\nnext\ntorn"].concat();
        for piece in [1, 100, MAX_LINE, text.len()] {
            let lines = lines(&text, piece);
            assert_eq!(lines.iter().map(Vec::len).collect::<Vec<_>>(), [5, MAX_LINE + 1, 4], "{piece}");
        }
    }
}
