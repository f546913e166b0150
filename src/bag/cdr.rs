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
