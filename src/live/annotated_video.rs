//! The annotated video: measured frames with the model drawn on them, as JPEGs, drawn on a thread of low priority while somebody
//! watches.

use super::low_priority::lower_priority;
use crate::camera::Frame;
use crate::measure::Eye;
use crate::observation::Measurement;
use crate::report::overlay::{Shape, narrowed, overlay};
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// Pictures drawn a second at most. Convention: a display choice.
const MAX_FPS: f64 = 8.0;
/// Wider frames are made smaller, px. Convention: a display choice.
const MAX_WIDTH: u32 = 960;
/// Quality of the JPEGs, of 100. Convention: a display choice.
const JPEG_QUALITY: u8 = 80;
/// Longest wait for a frame, after which the thread sees whether the run is over. Convention.
///
/// Convention: a timeout.
const TIMEOUT: Duration = Duration::from_millis(200);

/// A frame to draw.
#[derive(Clone)]
struct ToDraw {
    frame: Arc<Frame>,
    measurement: Measurement,
    eye: Arc<Eye>,
}

/// The latest measured frame, and whether it is drawn.
#[derive(Default)]
struct Latest {
    frame: Option<ToDraw>,
    is_drawn: bool,
}

/// The latest measured frame on its way in, and the latest picture (JPEG) on its way out.
pub struct AnnotatedVideo {
    latest: Mutex<Latest>,
    changed: Condvar,
    drawn: watch::Sender<Arc<Vec<u8>>>,
}

impl AnnotatedVideo {
    /// Starts the thread that draws; it ends when the video is dropped.
    pub fn start() -> Arc<Self> {
        let (drawn, _) = watch::channel(Arc::default());
        let video = Arc::new(Self { latest: Mutex::default(), changed: Condvar::new(), drawn });
        let of_thread = Arc::downgrade(&video);
        std::thread::spawn(move || {
            lower_priority();
            while let Some(video) = of_thread.upgrade() {
                video.draw_next();
            }
        });
        video
    }

    /// Hands over a frame, which is drawn if somebody watches; it replaces the one before.
    pub fn offer(&self, frame: &Arc<Frame>, measurement: &Measurement, eye: &Arc<Eye>) {
        let to_draw = ToDraw { frame: Arc::clone(frame), measurement: measurement.clone(), eye: Arc::clone(eye) };
        *self.lock() = Latest { frame: Some(to_draw), is_drawn: false };
        self.changed.notify_all();
    }

    /// The latest picture, even where no frame comes any more, and those from now on; a slow reader misses some.
    pub fn watch(&self) -> watch::Receiver<Arc<Vec<u8>>> {
        let mut pictures = self.drawn.subscribe();
        pictures.mark_changed();
        self.changed.notify_all();
        pictures
    }

    fn lock(&self) -> MutexGuard<'_, Latest> {
        self.latest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn draw_next(&self) {
        let nothing_to_do =
            |latest: &mut Latest| latest.is_drawn || latest.frame.is_none() || self.drawn.receiver_count() == 0;
        let waited = self.changed.wait_timeout_while(self.lock(), TIMEOUT, nothing_to_do);
        let (mut latest, timed_out) = waited.unwrap_or_else(PoisonError::into_inner);
        let Some(to_draw) = latest.frame.clone().filter(|_| !timed_out.timed_out()) else { return };
        latest.is_drawn = true;
        drop(latest);
        let began = Instant::now();
        let mut jpeg = Vec::new();
        let mut encoder = JpegEncoder::new_with_quality(&mut jpeg, JPEG_QUALITY);
        if encoder.encode_image(&to_draw.picture()).is_ok() {
            self.drawn.send_replace(Arc::new(jpeg));
        }
        std::thread::sleep(Duration::from_secs_f64(1.0 / MAX_FPS).saturating_sub(began.elapsed()));
    }
}

impl ToDraw {
    fn picture(&self) -> RgbImage {
        let shape = self.measurement.profile().map(|profile| Shape::of(&self.eye.projection(), profile));
        narrowed(overlay(&self.frame, &self.measurement, shape.as_ref()), MAX_WIDTH)
    }
}
