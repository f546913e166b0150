//! Encoder readings: none, a finished log matched to the frames by index, or lines or messages as they come, matched to the frames by time.
//!
//! Bytes go from [`line_reader`] (the only one that does input) through [`line_buffer`] and [`line_parser`] into [`readings`].

mod line_buffer;
mod line_parser;
mod line_reader;
mod readings;
mod stamp_rate;

pub use line_parser::{LineParser, Parsed};
pub use line_reader::EncoderSource;
pub use readings::Lookup;

use self::line_reader::LineReader;
use self::readings::Readings;
use super::clock::{FrameClock, unix_time_s};
use super::motion_lag::motion_lag;
use super::status::EncoderStatus;
use super::stream::ReadingStream;
use crate::observation::{EncoderReading, Wiring};
use crate::record::Interpolation;
use crate::robot::PerBackbone;
use nalgebra::Vector2;
use std::collections::HashMap;
use std::sync::Arc;

/// Where the encoder readings of frames come from.
#[derive(Debug)]
pub enum Encoders {
    /// There are none.
    None,
    /// A finished log, matched by the frames' index.
    Log(HashMap<u64, EncoderReading>),
    /// Lines or messages as they come.
    Lines(LineReader),
}

impl Encoders {
    /// A finished log.
    pub fn log(readings: Vec<EncoderReading>) -> Self {
        Self::Log(readings.into_iter().map(|reading| (reading.index, reading)).collect())
    }

    /// Starts to read lines, as a parser and a wiring tell them. The offset of the encoders' clock, s, is estimated where it is not
    /// given.
    pub fn lines(
        source: EncoderSource,
        (parser, wiring): (LineParser, Wiring),
        clock: Arc<FrameClock>,
        offset_s: Option<f64>,
    ) -> Self {
        let readings = Readings::new(wiring.columns.len(), offset_s).parsed_by(parser).wired(wiring);
        Self::Lines(LineReader::start(source, readings, clock))
    }

    /// Starts to take readings from a stream, in the same way.
    pub fn stream(
        stream: Box<dyn ReadingStream>,
        wiring: Wiring,
        clock: Arc<FrameClock>,
        offset_s: Option<f64>,
    ) -> Self {
        let readings = Readings::new(wiring.columns.len(), offset_s).wired(wiring).of_messages(offset_s);
        Self::Lines(LineReader::listen(stream, readings, clock))
    }

    /// The reading of a frame.
    pub fn at(&self, index: u64, time_s: f64) -> Lookup {
        match self {
            Self::None => Lookup::Never,
            Self::Log(readings) => readings.get(&index).map_or(Lookup::Never, |reading| Lookup::Found(*reading)),
            Self::Lines(lines) => lines.lock().at(index, time_s, unix_time_s()),
        }
    }

    /// What is known of the encoders.
    pub fn status(&self) -> EncoderStatus {
        match self {
            Self::None => EncoderStatus::at_rest("none", 0),
            Self::Log(readings) => EncoderStatus::at_rest("log", readings.len() as u64),
            Self::Lines(lines) => lines.lock().status(unix_time_s()),
        }
    }

    /// Estimates the lag between picture and encoders anew, from the last measured bend vectors (rad) and their times (s).
    pub fn estimate_lag(&self, bends: &[(f64, Vector2<f64>)], to_bend: &PerBackbone<Vector2<f64>>) {
        let (Self::Lines(lines), Some(first), Some(last)) = (self, bends.first(), bends.last()) else { return };
        // Copied, so that the lock is not held while the lag is estimated.
        let readings = lines.lock().in_frames_time(first.0, last.0);
        let mut interpolation = Interpolation::of(readings.iter());
        let lag = motion_lag(bends, |time_s| interpolation.at(time_s).map(|q| to_bend.tr_mul(&q)));
        if let Some(lag) = lag {
            lines.lock().set_lag(lag);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::line_buffer::MAX_LINE;
    use super::*;
    use crate::live::status::ClockState;
    use std::fs::File;
    use std::io::Write;
    use std::time::{Duration, Instant};

    #[test]
    fn no_part_of_a_line_is_taken_for_a_reading() {
        let readings = format!("0.0,0,0,0\n{}1.0,7,7,7\n0.1,0.01,0.01,0.01\n2.0,9,9,9", "x".repeat(3 * MAX_LINE));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("encoders.csv");
        std::fs::write(&path, &readings).unwrap();
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        for source in [EncoderSource::File(path), EncoderSource::Tcp(address)] {
            let tcp = matches!(source, EncoderSource::Tcp(_));
            let encoders = lines(source);
            if tcp {
                listener.accept().unwrap().0.write_all(readings.as_bytes()).unwrap();
            }
            assert_eq!(found(&encoders, 0.05)[0], 0.005);
            let status = encoders.status();
            assert_eq!((status.readings, status.bad_lines), (2, 1), "{status:?}");
            assert!(status.last_bad.unwrap().contains("more than 4096 bytes"));
        }
    }

    fn lines(source: EncoderSource) -> Encoders {
        Encoders::lines(source, (LineParser::new(3), Wiring::straight(3)), clock(), None)
    }

    fn clock() -> Arc<FrameClock> {
        let clock = Arc::new(FrameClock::default());
        clock.set(0.0);
        clock
    }

    /// Waits until there is an answer.
    fn found(encoders: &Encoders, time_s: f64) -> PerBackbone {
        let deadline = Instant::now() + Duration::from_secs(5);
        loop {
            match encoders.at(0, time_s) {
                Lookup::Found(reading) => return reading.q_mm,
                _ if Instant::now() > deadline => panic!("no reading: {:?}", encoders.status()),
                _ => std::thread::sleep(Duration::from_millis(5)),
            }
        }
    }

    #[test]
    fn a_growing_file_is_followed_and_interpolated() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("encoders.csv");
        let source = EncoderSource::File(path.clone());
        // Rows that are there at once tell nothing of the clock.
        let encoders = Encoders::lines(source, (LineParser::new(3), Wiring::straight(3)), clock(), Some(0.0));
        assert_eq!(encoders.status().state, "waiting");
        let mut file = File::create(&path).unwrap();
        let header_and_rows =
            b"time_s,q1_mm,q2_mm,q3_mm\n0.0,0,0,0\n0.1,1,2,-1\n0.2,2,4,-2\n0.3,3,6,-3\n0.4,4,8,-4\n0.5,5,";
        file.write_all(header_and_rows).unwrap();
        assert!((found(&encoders, 0.05) - PerBackbone::from([0.5, 1.0, -0.5])).norm() < 1e-12);
        assert_eq!(encoders.at(0, 0.45), Lookup::NotYet);
        file.write_all(b"10,-5\n9,0,0,0\n").unwrap();
        assert!((found(&encoders, 0.45) - PerBackbone::from([4.5, 9.0, -4.5])).norm() < 1e-12);
        assert_eq!(encoders.at(0, 5.0), Lookup::Never, "nobody knows what moved meanwhile");
        assert_eq!(encoders.status().state, "running");
    }

    #[test]
    fn sockets_that_close_are_opened_again() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let source: EncoderSource = format!("tcp://{}", listener.local_addr().unwrap()).parse().unwrap();
        let encoders = lines(source);
        for k in 0..2 {
            let (mut stream, _) = listener.accept().unwrap();
            let t = f64::from(k);
            writeln!(stream, "garbage\n{t},{k},0,0\n{},{k},0,0", t + 0.1).unwrap();
            assert_eq!(found(&encoders, t + 0.05)[0], t);
        }
        assert_eq!(encoders.status().bad_lines, 2);
    }

    #[cfg(unix)]
    #[test]
    fn a_unix_socket_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("encoders.sock");
        let listener = std::os::unix::net::UnixListener::bind(&path).unwrap();
        let source: EncoderSource = format!("unix:{}", path.display()).parse().unwrap();
        let encoders = Encoders::lines(source, (LineParser::new(3), Wiring::straight(3)), clock(), Some(0.5));
        let (mut stream, _) = listener.accept().unwrap();
        writeln!(stream, "{{\"time_s\": 1.0, \"q_mm\": [1, 2, 3]}}").unwrap();
        assert_eq!(found(&encoders, 1.5), PerBackbone::from([1.0, 2.0, 3.0]));
        assert_eq!(encoders.status().clock, ClockState::Given);
    }
}
