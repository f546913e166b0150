//! Pictures of a topic, and the lens that the camera beside it tells.

use super::super::stream::{Came, FrameStream, Packed, SentFrame};
use super::node::Node;
use super::sole_publisher::{Heard, SolePublisher};
use super::subscription::{Message, Subscription};
use crate::bag::Stamped;
use crate::bag::messages::{CameraInfo, stamp_s};
use crate::camera::Lens;
use crate::error::{Error, Result};
use rustdds::GUID;
use std::time::{Duration, Instant};

/// Pictures that may wait for the thread that reads them. Convention: as many as may wait to be decoded; more would only be older.
const DEPTH: i32 = 4;
/// Lost messages are counted over so many. Convention: a few seconds of a camera.
const COUNTED: i64 = 100;
/// Losses of more than this share are told. Convention: as for frames that are dropped.
const MANY_LOST: f64 = 0.1;
/// Time to wait for a camera's lens. Convention: a timeout, longer than discovery takes.
const LENS_TIMEOUT: Duration = Duration::from_secs(10);

/// The pictures of a topic, of one publisher.
#[derive(Debug)]
pub struct Pictures {
    subscription: Subscription,
    publisher: SolePublisher<GUID>,
    losses: Losses,
}

impl Pictures {
    /// Subscribes to a topic.
    ///
    /// # Errors
    /// A thread that cannot be set up.
    pub fn of(node: &Node, topic: &str) -> Result<Self> {
        let kinds = &["sensor_msgs/Image", "sensor_msgs/CompressedImage"];
        let subscription = Subscription::new(node, topic, kinds, DEPTH)?;
        Ok(Self { subscription, publisher: SolePublisher::new(), losses: Losses::default() })
    }

    fn taken(&mut self, message: Message) -> Option<Came<SentFrame>> {
        let topic = self.subscription.topic();
        match self.publisher.hear(message.publisher, Instant::now()) {
            Heard::PassedOver => return None,
            Heard::TakenOfTwo => {
                self.losses.remarks.push(format!(
                    "{topic} has two publishers: the pictures of the one that came first are taken, the other's passed over; end one of them"
                ));
            }
            Heard::Taken => {}
        }
        if let Some(share) = self.losses.count(message.number) {
            self.losses.remarks.push(format!(
                "{topic}: {:.0} % of the pictures are lost on their way: publish them compressed, or allow larger buffers (sysctl \
                 net.core.rmem_max)",
                100.0 * share
            ));
        }
        match stamp_s(&message.cdr) {
            Some(stamp_s) => {
                let packed = Packed::Message { kind: message.kind, cdr: message.cdr };
                Some(Came::One(SentFrame { packed, stamp_s: Some(stamp_s) }))
            }
            None => Some(Came::Remark(format!("{topic}: a message is no {}: it is cut short", message.kind))),
        }
    }
}

impl FrameStream for Pictures {
    fn next(&mut self, goes_on: &dyn Fn() -> bool) -> Option<Came<SentFrame>> {
        loop {
            if let Some(remark) = self.losses.remarks.pop() {
                return Some(Came::Remark(remark));
            }
            match self.subscription.next(goes_on)? {
                Came::Remark(text) => return Some(Came::Remark(text)),
                Came::One(message) => {
                    if let Some(came) = self.taken(message) {
                        return Some(came);
                    }
                }
            }
        }
    }

    fn trouble(&self) -> String {
        self.subscription.trouble()
    }
}

/// Messages that did not come, by the numbers of those that did.
#[derive(Debug, Default)]
struct Losses {
    /// The number of the last message, and those counted since the last look: that came, and that were lost.
    last: Option<i64>,
    came: i64,
    lost: i64,
    told: bool,
    /// To be told.
    remarks: Vec<String>,
}

impl Losses {
    /// A message of this number came; the share that was lost, the first time that it is large.
    fn count(&mut self, number: i64) -> Option<f64> {
        let step = self.last.map_or(1, |last| number - last);
        self.last = Some(number);
        // A publisher that was started anew counts anew.
        self.lost += if (1..COUNTED).contains(&step) { step - 1 } else { 0 };
        self.came += 1;
        if self.came + self.lost < COUNTED {
            return None;
        }
        let share = self.lost as f64 / (self.came + self.lost) as f64;
        (self.came, self.lost) = (0, 0);
        let tell = share > MANY_LOST && !self.told;
        self.told |= tell;
        tell.then_some(share)
    }
}

/// The topic of `CameraInfo` beside a topic of pictures, as ROS 2's cameras name it.
fn info_beside(image_topic: &str) -> String {
    let raw = image_topic.trim_end_matches("/compressed");
    let folder = raw.rsplit_once('/').map_or("", |(folder, _)| folder);
    format!("{folder}/camera_info")
}

/// The lens that the camera of an image topic tells, waited for.
///
/// # Errors
/// No message in time; a camera that was not calibrated, or one of another model.
pub fn lens_of(node: &Node, image_topic: &str) -> Result<Lens> {
    let topic = info_beside(image_topic);
    let wrong = |message: String| Error::Unavailable {
        what: format!("{topic}, for the lens that experiment.toml does not name"),
        message,
    };
    let mut subscription = Subscription::new(node, &topic, CameraInfo::KINDS, 1)?;
    let began = Instant::now();
    let mut remarked = None;
    while began.elapsed() < LENS_TIMEOUT {
        match subscription.next(&|| began.elapsed() < LENS_TIMEOUT) {
            Some(Came::One(message)) => {
                let info = CameraInfo::decoded(message.kind, &message.cdr).map_err(wrong)?;
                return Lens::of_info(&info).map_err(wrong);
            }
            Some(Came::Remark(text)) => remarked = Some(text),
            None => {}
        }
    }
    Err(wrong(remarked.unwrap_or_else(|| subscription.trouble()) + "; or name a camera file in experiment.toml"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn camera_info_stands_beside_the_pictures() {
        assert_eq!(info_beside("/camera/image_raw"), "/camera/camera_info");
        assert_eq!(info_beside("/lab/side/image_raw/compressed"), "/lab/side/camera_info");
        assert_eq!(info_beside("/image"), "/camera_info");
    }

    #[test]
    fn losses_are_told_once_and_a_publisher_that_counts_anew_lost_none() {
        let mut losses = Losses::default();
        assert_eq!((1..=100).find_map(|number| losses.count(number)), None);
        let told: Vec<f64> = (51..=150).filter_map(|k| losses.count(2 * k)).collect();
        assert!(told.len() == 1 && (told[0] - 0.5).abs() < 0.02, "{told:?}");
        let mut losses = Losses::default();
        assert_eq!((1..=60).chain(1..=60).find_map(|number| losses.count(number)), None);
    }
}
