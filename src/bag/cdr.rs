//! CDR, the encoding of ROS 2 messages: numbers aligned to their size from the end of the four bytes that say the byte order; texts
//! and sequences behind their length.
//!
//! Source: OMG DDS-XTypes 1.3, section 7.4 (XCDR version 1); the layout of the messages is their definition's.

/// Reads the values of a message one after another.
pub struct Cdr<'a> {
    bytes: &'a [u8],
    at: usize,
    little: bool,
}

/// Why a message cannot be read.
pub type CdrResult<T> = Result<T, String>;

impl<'a> Cdr<'a> {
    /// The message behind its encapsulation.
    ///
    /// # Errors
    /// Another encapsulation than plain CDR.
    pub fn new(message: &'a [u8]) -> CdrResult<Self> {
        match message {
            [0, order @ (0 | 1), _, _, bytes @ ..] => Ok(Self { bytes, at: 0, little: *order == 1 }),
            [0x28, 0xb5, 0x2f, 0xfd, ..] => {
                Err("each message is packed by itself (compression_mode: message), which is not read; convert the \
                recording without it (ros2 bag convert)"
                    .to_owned())
            }
            [a, b, ..] => Err(format!("encapsulation {a:02x} {b:02x}, expected plain CDR (00 00 or 00 01)")),
            _ => Err("the message is empty".to_owned()),
        }
    }

    fn take(&mut self, length: usize) -> CdrResult<&'a [u8]> {
        let end = self.at.checked_add(length).filter(|end| *end <= self.bytes.len());
        let end = end.ok_or_else(|| format!("the message is cut short after {} bytes", self.bytes.len()))?;
        let taken = &self.bytes[self.at..end];
        self.at = end;
        Ok(taken)
    }

    fn aligned<const N: usize>(&mut self) -> CdrResult<[u8; N]> {
        self.at = self.at.next_multiple_of(N);
        let taken = self.take(N)?;
        let mut number = [0; N];
        number.copy_from_slice(taken);
        if !self.little {
            number.reverse();
        }
        Ok(number)
    }

    /// A byte.
    ///
    /// # Errors
    /// A message that is cut short.
    pub fn u8(&mut self) -> CdrResult<u8> {
        Ok(self.take(1)?[0])
    }

    /// A number of 32 bits.
    ///
    /// # Errors
    /// A message that is cut short.
    pub fn u32(&mut self) -> CdrResult<u32> {
        self.aligned().map(u32::from_le_bytes)
    }

    /// A number of 32 bits with a sign.
    ///
    /// # Errors
    /// A message that is cut short.
    pub fn i32(&mut self) -> CdrResult<i32> {
        self.aligned().map(i32::from_le_bytes)
    }

    /// A number of 64 bits with a fraction.
    ///
    /// # Errors
    /// A message that is cut short.
    pub fn f64(&mut self) -> CdrResult<f64> {
        self.aligned().map(f64::from_le_bytes)
    }

    /// So many of them.
    ///
    /// # Errors
    /// A message that is cut short.
    pub fn f64s<const N: usize>(&mut self) -> CdrResult<[f64; N]> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.f64()?;
        }
        Ok(numbers)
    }

    /// A sequence of them.
    ///
    /// # Errors
    /// A message that is cut short.
    pub fn f64_sequence(&mut self) -> CdrResult<Vec<f64>> {
        // No longer than the message, whatever it says.
        (0..self.u32()?).map(|_| self.f64()).collect()
    }

    /// A sequence of bytes.
    ///
    /// # Errors
    /// A message that is cut short.
    pub fn bytes(&mut self) -> CdrResult<&'a [u8]> {
        let length = self.u32()? as usize;
        self.take(length)
    }

    /// A text; its length counts the zero at its end.
    ///
    /// # Errors
    /// A message that is cut short.
    pub fn text(&mut self) -> CdrResult<String> {
        let bytes = self.bytes()?;
        Ok(String::from_utf8_lossy(bytes.strip_suffix(&[0]).unwrap_or(bytes)).into_owned())
    }

    /// A sequence of texts.
    ///
    /// # Errors
    /// A message that is cut short.
    pub fn texts(&mut self) -> CdrResult<Vec<String>> {
        (0..self.u32()?).map(|_| self.text()).collect()
    }
}

/// The bytes that say the byte order: plain CDR, little-endian, no options.
///
/// Source: DDS-XTypes 1.3, table 60 (`CDR_LE`).
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Writes the values of a message one after another, as [`Cdr`] reads them.
pub struct CdrWriter {
    /// The message so far, behind its encapsulation.
    bytes: Vec<u8>,
}

impl CdrWriter {
    /// A message that has no values yet.
    pub fn begin() -> Self {
        Self { bytes: ENCAPSULATION.to_vec() }
    }

    /// The message with its encapsulation.
    pub fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    fn aligned<const N: usize>(&mut self, number: [u8; N]) {
        let at = (self.bytes.len() - ENCAPSULATION.len()).next_multiple_of(N);
        self.bytes.resize(ENCAPSULATION.len() + at, 0);
        self.bytes.extend(number);
    }

    /// A byte.
    pub fn u8(&mut self, value: u8) {
        self.bytes.push(value);
    }

    /// A number of 32 bits.
    pub fn u32(&mut self, value: u32) {
        self.aligned(value.to_le_bytes());
    }

    /// A number of 32 bits with a sign.
    pub fn i32(&mut self, value: i32) {
        self.aligned(value.to_le_bytes());
    }

    /// A number of 64 bits.
    pub fn u64(&mut self, value: u64) {
        self.aligned(value.to_le_bytes());
    }

    /// A number of 64 bits with a fraction.
    pub fn f64(&mut self, value: f64) {
        self.aligned(value.to_le_bytes());
    }

    /// How many values a sequence has, of which CDR counts 32 bits: a picture or a line of text has fewer.
    pub fn length(&mut self, length: usize) {
        self.u32(length as u32);
    }

    /// A sequence of numbers.
    pub fn f64_sequence(&mut self, values: &[f64]) {
        self.length(values.len());
        values.iter().for_each(|&value| self.f64(value));
    }

    /// A sequence of bytes.
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.length(bytes.len());
        self.bytes.extend(bytes);
    }

    /// A text; its length counts the zero at its end.
    pub fn text(&mut self, text: &str) {
        self.length(text.len() + 1);
        self.bytes.extend(text.as_bytes());
        self.bytes.push(0);
    }

    /// A sequence of texts.
    pub fn texts(&mut self, texts: &[String]) {
        self.length(texts.len());
        texts.iter().for_each(|text| self.text(text));
    }
}
