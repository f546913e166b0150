//! How fast the encoders' time stamps run beside this machine's clock, and how many of their lines can be used: a unit other than seconds, times that
//! run backwards or stand still, and lines of another form show here, whatever the offset of the clocks is.

/// Seconds of this machine's clock over which stamps and lines are looked at.
///
/// Convention: long beside the bursts that lines come in, and short beside what a person waits for.
const WINDOW_S: f64 = 1.0;
/// Lines without which a window says nothing. Convention: the first and the last may be jittered by a tenth of what lies between them.
const LEAST_LINES: u32 = 10;
/// Windows in a row that must say the same.
///
/// Convention: one may be a backlog that is read at once, or a clock that was set.
const WINDOWS: u32 = 3;
/// A rate within this factor of a unit's is that unit's. Convention: a log is not played back faster than this without being asked to.
const WITHIN: f64 = 2.0;
/// Of what unit the stamps are, by how many of it pass in a second. Derived: from the unit's name.
const UNITS: [(f64, &str); 4] =
    [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds"), (1.0 / 60.0, "minutes")];

/// What lines and stamps did in a window.
#[derive(Debug, Default)]
struct Window {
    since_unix_s: f64,
    first_stamp_s: Option<f64>,
    last_stamp_s: f64,
    lines: u32,
    refused: u32,
    why: String,
}

/// What speaks against the stamps, or against most of the lines.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Doubt {
    Unit(usize),
    Refused,
}

/// Watches stamps and lines.
#[derive(Debug, Default)]
pub struct StampRate {
    window: Window,
    /// What the last windows said, and how many in a row.
    doubt: Option<(Doubt, u32)>,
}

impl StampRate {
    /// Notes a line that came at a Unix time, s: its stamp, s, where it has one, and why it was refused, if it was.
    pub fn note(&mut self, unix_s: f64, stamp_s: Option<f64>, refused: Option<&str>) {
        if !(0.0..WINDOW_S).contains(&(unix_s - self.window.since_unix_s)) {
            self.close(unix_s);
        }
        let window = &mut self.window;
        window.lines = window.lines.saturating_add(1);
        if let Some(why) = refused {
            window.refused += 1;
            why.clone_into(&mut window.why);
        }
        if let Some(stamp_s) = stamp_s {
            window.first_stamp_s.get_or_insert(stamp_s);
            window.last_stamp_s = stamp_s;
        }
    }

    /// The name of the unit that the stamps are in, if it is not the second.
    pub fn other_unit(&self) -> Option<&'static str> {
        match self.doubt {
            Some((Doubt::Unit(unit), WINDOWS..)) => Some(UNITS[unit].1),
            _ => None,
        }
    }

    /// What is to be told of the lines, in a sentence; the same one as long as it holds.
    pub fn remark(&self) -> Option<String> {
        match self.doubt? {
            (Doubt::Unit(unit), WINDOWS..) => Some(format!(
                "the encoders' time_s runs in {}, expected seconds: no reading is used; send seconds, or name the column and its unit under \
                 [log] of experiment.toml",
                UNITS[unit].1
            )),
            (Doubt::Refused, WINDOWS..) => Some(
                "most lines of the encoders cannot be used, and a clock that runs backwards or stands still, decimal commas or another number of \
                 columns are the usual causes"
                    .to_owned(),
            ),
            _ => None,
        }
    }

    /// Ends the window and begins another.
    fn close(&mut self, unix_s: f64) {
        let window = std::mem::replace(&mut self.window, Window { since_unix_s: unix_s, ..Window::default() });
        if window.lines < LEAST_LINES {
            return;
        }
        let found = window.doubt(unix_s);
        self.doubt = found.map(|found| match self.doubt {
            Some((before, windows)) if before == found => (found, windows.saturating_add(1)),
            _ => (found, 1),
        });
    }
}

impl Window {
    fn doubt(&self, unix_s: f64) -> Option<Doubt> {
        let rate = self.first_stamp_s.map_or(0.0, |first_s| self.last_stamp_s - first_s) / (unix_s - self.since_unix_s);
        let is_near = |unit: f64| (unit / WITHIN..=unit * WITHIN).contains(&rate);
        if let Some(unit) = UNITS.iter().position(|&(unit, _)| is_near(unit)) {
            return Some(Doubt::Unit(unit));
        }
        (2 * self.refused > self.lines).then_some(Doubt::Refused)
    }
}
