//! The encoder readings so far, by the encoders' own time stamps. Looks at no clock itself: the caller says what time it is.

use super::line_parser::{LineParser, Parsed, is_reading};
use super::stamp_rate::StampRate;
use crate::live::clock_offset::ClockOffset;
use crate::live::status::{EncoderStatus, Lag};
use crate::live::stream::{Came, SentReading};
use crate::observation::{EncoderReading, Wiring};
use crate::record::Interpolation;
use crate::robot::PerBackbone;
use std::collections::VecDeque;
use std::time::Duration;

/// Encoders from which nothing comes for this time are lost. Convention.
///
/// Convention: a timeout.
pub const SILENCE: Duration = Duration::from_secs(2);
/// Readings before a frame and after it by which a gap between two is judged. Convention: a resource limit, a second of a bus of 1 kHz.
const AROUND_A_FRAME: usize = 512;
/// Readings nearer to the last one kept than this are counted and not kept, s.
///
/// Convention: a resource limit: those that are kept reach back a minute at least, and nothing bends meanwhile.
const FINEST_S: f64 = 0.5e-3;
/// More readings a second than this are told, since most of them are not kept. Convention: twice as many as are.
const FLOOD_PER_S: f64 = 4000.0;
/// Readings kept: two minutes of a bus of 1 kHz. Convention: a resource limit, about 10 MB.
const MAX_READINGS: usize = 120_000;
/// A time stamp earlier than the last by more than this comes from a clock that was set anew, s; by less, from a line that is to be
/// refused. Convention.
///
/// Convention: a step of a clock, not a jitter.
const CLOCK_SET_BACK_S: f64 = 0.25;
/// Remarks on the encoders that are kept. Convention: a resource limit.
const MAX_REMARKS: usize = 20;
/// Readings this long before the first bend and after the last are given to the estimation of the lag, s. Convention: longer than the
/// longest lag that is tried.
const AROUND_S: f64 = 1.0;

/// The reading that belongs to a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "it lives for one match, and nothing is allocated at the camera's pace")]
pub enum Lookup {
    /// This one.
    Found(EncoderReading),
    /// It may still come.
    NotYet,
    /// There is none.
    Never,
}

/// Readings with the time stamp of each.
#[derive(Debug)]
pub struct Readings {
    parser: LineParser,
    wiring: Wiring,
    stamped: VecDeque<(f64, PerBackbone)>,
    offset: ClockOffset,
    lag: Option<Lag>,
    count: u64,
    bad_lines: u64,
    last_bad: Option<String>,
    trouble: Option<String>,
    remarks: Vec<String>,
    last_unix_s: Option<f64>,
    flood: Flood,
    stamp_rate: StampRate,
    /// Whether the lines that are taken may have waited to be read.
    may_have_waited: bool,
}

/// How many readings come, counted from one second to the next.
#[derive(Debug, Default)]
struct Flood {
    since_unix_s: f64,
    count: u32,
    told: bool,
}

impl Flood {
    /// Counts a reading that came at a Unix time, s; gives the rate, once, where it is so high that most are not kept.
    fn rate_to_tell(&mut self, unix_s: f64) -> Option<f64> {
        self.count += 1;
        let elapsed_s = unix_s - self.since_unix_s;
        // A clock that was set back begins anew.
        if (0.0..1.0).contains(&elapsed_s) {
            return None;
        }
        let rate = f64::from(self.count) / elapsed_s;
        (self.since_unix_s, self.count) = (unix_s, 0);
        let is_flood = !self.told && rate > FLOOD_PER_S;
        self.told |= is_flood;
        is_flood.then_some(rate)
    }
}

impl Readings {
    /// No readings yet of a robot with so many backbones. The offset of the encoders' clock, s, is estimated where it is not given.
    pub fn new(backbones: usize, given_offset_s: Option<f64>) -> Self {
        Self {
            parser: LineParser::new(backbones),
            wiring: Wiring::straight(backbones),
            stamped: VecDeque::new(),
            offset: ClockOffset::new(given_offset_s),
            lag: None,
            count: 0,
            bad_lines: 0,
            last_bad: None,
            trouble: None,
            remarks: Vec::new(),
            last_unix_s: None,
            flood: Flood::default(),
            stamp_rate: StampRate::default(),
            may_have_waited: false,
        }
    }

    /// Whether the next lines may have waited to be read, so that nobody knows when they came.
    pub fn set_waited(&mut self, may_have_waited: bool) {
        self.may_have_waited = may_have_waited;
    }

    /// The same of lines that a parser of their own reads.
    pub fn parsed_by(self, parser: LineParser) -> Self {
        Self { parser, ..self }
    }

    /// The same of lines whose columns, signs and unit a wiring tells; rows have no numbers here, so that its shift means nothing.
    pub fn wired(self, wiring: Wiring) -> Self {
        Self { wiring, ..self }
    }

    /// The same of messages, whose times are mostly the frames'.
    pub fn of_messages(self, given_offset_s: Option<f64>) -> Self {
        Self { offset: ClockOffset::of_messages(given_offset_s), ..self }
    }

    /// Takes a line that arrived at `arrival_s` of the frames' clock (`None` before that runs) and at a Unix time.
    pub fn take(&mut self, line: &[u8], arrival_s: Option<f64>, unix_s: f64) {
        let taken: Parsed = self.parser.parse(line);
        let (stamp_s, added) = match taken {
            Ok(Some((stamp_s, q_mm))) => (Some(stamp_s), self.add(stamp_s, self.wiring.q_mm(&q_mm), arrival_s, unix_s)),
            Ok(None) => return,
            Err(why) => (None, Err(why)),
        };
        self.note(unix_s, stamp_s, added);
    }

    /// Counts a reading, or notes why it was refused.
    fn note(&mut self, unix_s: f64, stamp_s: Option<f64>, added: std::result::Result<(), String>) {
        // Nobody knows when those came that may have waited.
        if !self.may_have_waited {
            self.stamp_rate.note(unix_s, stamp_s, added.as_ref().err().map(String::as_str));
            if let Some(remark) = self.stamp_rate.remark() {
                self.remark(remark);
            }
        }
        if let Err(why) = added {
            self.refuse(why);
        }
    }

    /// Takes what came on a stream at `arrival_s` of the frames' clock (`None` before that runs) and at a Unix time.
    pub fn take_sent(&mut self, came: Came<SentReading>, arrival_s: Option<f64>, unix_s: f64) {
        match came {
            Came::Remark(text) => self.remark(text),
            Came::One(SentReading::Bad(why)) => self.refuse(why),
            Came::One(SentReading::Contradicted { stamp_s, why }) => {
                if self.stamped.back().is_some_and(|&(last_s, _)| last_s == stamp_s) {
                    self.stamped.pop_back();
                }
                self.remark(why.clone());
                self.refuse(why);
            }
            Came::One(SentReading::Reading { stamp_s, q_mm }) => {
                let q_mm = self.wiring.q_mm(&q_mm);
                let added = match is_reading(stamp_s, &q_mm) {
                    true => self.add(stamp_s, q_mm, arrival_s, unix_s),
                    false => Err(format!("{:?} at {stamp_s} s: not a reading in mm", &q_mm[..])),
                };
                self.note(unix_s, Some(stamp_s), added);
            }
        }
    }

    fn refuse(&mut self, why: String) {
        self.bad_lines += 1;
        self.last_bad = Some(why);
    }

    /// Notes something that the user is to know of the encoders, once.
    pub fn remark(&mut self, text: String) {
        if self.remarks.len() < MAX_REMARKS && !self.remarks.contains(&text) {
            self.remarks.push(text);
        }
    }

    fn add(
        &mut self,
        stamp_s: f64,
        q_mm: PerBackbone,
        arrival_s: Option<f64>,
        unix_s: f64,
    ) -> std::result::Result<(), String> {
        if let Some(unit) = self.stamp_rate.other_unit() {
            self.stamped.clear();
            self.offset.restart();
            return Err(format!("time_s {stamp_s} is in {unit}, expected seconds"));
        }
        if let Some(&(last_s, _)) = self.stamped.back()
            && stamp_s <= last_s
        {
            if last_s - stamp_s < CLOCK_SET_BACK_S {
                return Err(format!("time_s {stamp_s} is not after {last_s}"));
            }
            self.stamped.clear();
            self.offset.restart();
        }
        if let Some(arrival_s) = arrival_s {
            self.offset.observe(stamp_s, arrival_s, self.may_have_waited);
        }
        self.count += 1;
        self.trouble = None;
        self.last_unix_s = Some(unix_s);
        if let Some(rate) = self.flood.rate_to_tell(unix_s) {
            self.remark(format!(
                "about {:.0},000 encoder readings come a second, and one each {} ms is kept: send fewer, some hundreds are plenty",
                rate / 1000.0,
                1000.0 * FINEST_S
            ));
        }
        if self.stamped.back().is_some_and(|&(last_s, _)| stamp_s - last_s < FINEST_S) {
            return Ok(());
        }
        if self.stamped.len() == MAX_READINGS {
            self.stamped.pop_front();
        }
        self.stamped.push_back((stamp_s, q_mm));
        Ok(())
    }

    /// The connection is gone, for this reason; the next one may have another header.
    pub fn disconnected(&mut self, trouble: String) {
        self.trouble = Some(trouble);
        self.parser.reset();
    }

    /// The reading at a frame's time, s, interpolated linearly between its neighbours as far as the motion allows it, as in recordings.
    pub fn at(&self, index: u64, time_s: f64, unix_s: f64) -> Lookup {
        let stamp_s = time_s - self.offset.estimate().1;
        match self.stamped.back() {
            Some(&(last_s, _)) if last_s >= stamp_s => {}
            _ if self.is_silent(unix_s) => return Lookup::Never,
            _ => return Lookup::NotYet,
        }
        let after = self.stamped.partition_point(|&(s, _)| s < stamp_s);
        let around = after.saturating_sub(AROUND_A_FRAME)..(after + AROUND_A_FRAME).min(self.stamped.len());
        match Interpolation::of(self.stamped.range(around)).at(stamp_s) {
            Some(q_mm) => Lookup::Found(EncoderReading::new(index, time_s, q_mm)),
            None => Lookup::Never,
        }
    }

    /// The readings from shortly before one time of the frames' clock, s, to shortly after another, with their times by it.
    pub fn in_frames_time(&self, first_s: f64, last_s: f64) -> Vec<(f64, PerBackbone)> {
        let offset_s = self.offset.estimate().1;
        let from = self.stamped.partition_point(|&(s, _)| s + offset_s < first_s - AROUND_S);
        let to = self.stamped.partition_point(|&(s, _)| s + offset_s < last_s + AROUND_S);
        self.stamped.range(from..to).map(|&(s, q)| (s + offset_s, q)).collect()
    }

    /// Notes by how much the picture is behind.
    pub fn set_lag(&mut self, lag: Lag) {
        self.lag = Some(lag);
    }

    /// Whether nothing has come for a while, so that nothing need be waited for.
    fn is_silent(&self, unix_s: f64) -> bool {
        self.last_unix_s.is_none_or(|last| unix_s - last > SILENCE.as_secs_f64())
    }

    /// What is known of the encoders.
    pub fn status(&self, unix_s: f64) -> EncoderStatus {
        let (clock, offset_s) = self.offset.estimate();
        EncoderStatus {
            state: match self.last_unix_s {
                None => "waiting",
                Some(_) if self.is_silent(unix_s) => "lost",
                Some(_) => "running",
            },
            trouble: self.trouble.clone(),
            readings: self.count,
            bad_lines: self.bad_lines,
            last_bad: self.last_bad.clone(),
            clock,
            offset_s,
            lag: self.lag,
            remarks: self.remarks.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::status::ClockState;

    /// Readings of these lines, which arrive as they are stamped.
    fn readings(lines: &[&str]) -> Readings {
        let mut readings = Readings::new(3, None);
        lines.iter().for_each(|line| readings.take(line.as_bytes(), None, 100.0));
        readings
    }

    fn found(lookup: Lookup) -> PerBackbone {
        match lookup {
            Lookup::Found(reading) => reading.q_mm,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_reading_is_interpolated_between_its_neighbours() {
        let lines = ["0.0,0,0,0", "0.1,1,2,-1", "0.2,2,4,-2", "0.3,3,6,-3", "0.4,4,8,-4", "0.5,5,10,-5", "9.0,0,0,0"];
        let readings = readings(&lines);
        let at = |time_s| readings.at(0, time_s, 100.0);
        assert!((found(at(0.05)) - PerBackbone::from([0.5, 1.0, -0.5])).norm() < 1e-12);
        assert!((found(at(0.25)) - PerBackbone::from([2.5, 5.0, -2.5])).norm() < 1e-12);
        assert_eq!(at(5.0), Lookup::Never, "nobody knows what moved meanwhile");
        assert_eq!(at(-1.0), Lookup::Never, "before the first");
        assert_eq!(at(9.5), Lookup::NotYet);
        assert_eq!(readings.at(0, 9.5, 103.0), Lookup::Never, "silent for longer than two seconds");
    }

    #[test]
    fn a_sender_of_changes_only_is_bridged_while_nothing_moves() {
        let moving = |k: u32| (0.1 * f64::from(k), f64::from(k.min(10)));
        let line = |(time_s, q): (f64, f64)| format!("{time_s},{q},0,0");
        let lines: Vec<String> = (0..=10).chain([28, 29]).map(moving).map(line).collect();
        let readings = readings(&lines.iter().map(String::as_str).collect::<Vec<_>>());
        assert_eq!(found(readings.at(0, 2.0, 100.0))[0], 10.0);
    }

    #[test]
    fn of_a_flood_some_are_kept_and_it_is_told_once() {
        let mut readings = Readings::new(3, None);
        for k in 0..300_000 {
            let time_s = f64::from(k) * 1e-5;
            readings.take(format!("{time_s},{time_s},0,0").as_bytes(), Some(time_s), 100.0 + time_s);
        }
        assert!((found(readings.at(0, 2.5, 103.0))[0] - 2.5).abs() < 1e-9);
        assert!((5800..=6100).contains(&readings.stamped.len()));
        let status = readings.status(103.0);
        assert_eq!((status.readings, status.bad_lines, status.remarks.len()), (300_000, 0, 1));
        assert!(status.remarks[0].starts_with("about 100,000 encoder readings come a second"), "{status:?}");
    }

    #[test]
    fn stamps_that_stutter_are_refused_and_a_clock_set_back_begins_anew() {
        let mut readings = readings(&["5.0,0,0,0", "5.0,1,0,0", "4.9,1,0,0"]);
        let status = readings.status(100.0);
        assert_eq!((status.readings, status.bad_lines, status.state), (1, 2, "running"));
        assert!(status.last_bad.unwrap().contains("4.9 is not after 5"));
        readings.take(b"1.0,3,0,0", None, 100.0);
        assert_eq!(found(readings.at(0, 1.0, 100.0))[0], 3.0);
    }

    #[test]
    fn readings_are_paired_at_once_after_a_clock_was_set_back() {
        let mut readings = Readings::new(3, None);
        // The reading at each moment is its time, mm.
        let mut error_mm = |from: u32, to: u32, back_s: f64| {
            for k in from..to {
                let time_s = f64::from(k) / 100.0;
                readings.take(format!("{},{time_s},0,0", time_s - back_s).as_bytes(), Some(time_s + 0.001), 100.0);
            }
            let asked_s = f64::from(to - 1) / 100.0 - 0.05;
            (found(readings.at(0, asked_s, 100.0))[0] - asked_s).abs()
        };
        assert!(error_mm(0, 1500, 0.0) < 0.002);
        // Half a second: 20 readings later they are paired as before, to the delay of the line.
        assert!(error_mm(1500, 1520, 0.5) < 0.002);
    }

    #[test]
    fn stamps_in_another_unit_are_told_and_refused_and_taken_again_once_they_are_seconds() {
        for (per_s, unit) in [(1e3, "milliseconds"), (1e6, "microseconds"), (1.0 / 60.0, "minutes"), (1.0, "")] {
            let mut readings = Readings::new(3, None);
            let mut send = |from: u32, per_s: f64| {
                for k in from..from + 600 {
                    let time_s = f64::from(k) / 100.0;
                    readings.take(format!("{},1,0,0", 7.0 + per_s * time_s).as_bytes(), Some(time_s), 100.0 + time_s);
                }
                readings.status(100.0 + f64::from(from + 600) / 100.0)
            };
            let status = send(0, per_s);
            let told = status.remarks.iter().any(|remark| !unit.is_empty() && remark.contains(unit));
            assert_eq!((told, status.remarks.len()), (!unit.is_empty(), usize::from(!unit.is_empty())), "{status:?}");
            assert_eq!(status.last_bad.is_some(), !unit.is_empty(), "{status:?}");
            let bad_lines = send(600, 1.0).bad_lines;
            assert!(send(1200, 1.0).bad_lines - bad_lines < 10, "{unit}");
        }
    }

    #[test]
    fn lines_of_which_most_cannot_be_used_are_told_and_a_double_sender_is_not() {
        let lines = |k: u32, what: &str| match what {
            "backwards" => vec![format!("{},0,0,0", 900.0 - f64::from(k) / 100.0)],
            "standing" => vec!["5.0,0,0,0".to_owned()],
            "commas" => vec![format!("{},1,2,0,1,0,1,0", k / 100)],
            "twice" => vec![format!("{},0,0,0", f64::from(k) / 100.0); 2],
            _ => vec![format!("{},0,0,0", f64::from(k) / 100.0)],
        };
        for (what, is_told) in
            [("backwards", true), ("standing", true), ("commas", true), ("twice", false), ("sound", false)]
        {
            let mut readings = Readings::new(3, None);
            for k in 0..800 {
                let time_s = f64::from(k) / 100.0;
                lines(k, what).iter().for_each(|line| readings.take(line.as_bytes(), Some(time_s), 100.0 + time_s));
            }
            let remarks = readings.status(108.0).remarks;
            assert_eq!(remarks.iter().any(|remark| remark.contains("most lines")), is_told, "{what}: {remarks:?}");
        }
    }

    #[test]
    fn a_given_offset_is_obeyed_and_another_header_understood_after_a_disconnection() {
        let mut readings = Readings::new(3, Some(0.5));
        readings.take(b"q3_mm,q2_mm,q1_mm,time_s", Some(0.0), 100.0);
        readings.take(b"3,2,1,1.0", Some(77.0), 100.0);
        assert_eq!(found(readings.at(0, 1.5, 100.0)), PerBackbone::from([1.0, 2.0, 3.0]));
        assert_eq!(readings.status(100.0).clock, ClockState::Given);
        readings.disconnected("gone".into());
        assert_eq!(readings.status(200.0).state, "lost");
        readings.take(b"1.2,1,2,3", Some(78.0), 200.0);
        let status = readings.status(200.0);
        assert_eq!((status.trouble, status.bad_lines), (None, 0));
        assert_eq!(found(readings.at(0, 1.7, 200.0)), PerBackbone::from([1.0, 2.0, 3.0]));
    }

    #[test]
    fn those_around_some_bends_are_given_in_the_frames_time() {
        let mut readings = Readings::new(3, Some(100.0));
        (0..100).for_each(|k| readings.take(format!("{}.5,0,0,0", k).as_bytes(), None, 0.0));
        let times: Vec<f64> = readings.in_frames_time(110.0, 111.0).iter().map(|(s, _)| *s).collect();
        assert_eq!(times, [109.5, 110.5, 111.5]);
    }
}
