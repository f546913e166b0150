//! The annotated video: measured frames with the model drawn on them, as JPEGs, drawn on a thread of low priority while somebody
//! watches.

use super::low_priority::lower_priority;
use crate::camera::Frame;
use crate::measure::Eye;
use crate::observation::Measurement;
use crate::report::overlay::{Shape, overlay};
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{FilterType, resize};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
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
struct ToDraw {
    frame: Arc<Frame>,
    measurement: Measurement,
    eye: Arc<Eye>,
}

/// The latest measured frame on its way in, and the latest picture (JPEG) on its way out.
pub struct AnnotatedVideo {
    latest: Mutex<Option<ToDraw>>,
    changed: Condvar,
    drawn: watch::Sender<Arc<Vec<u8>>>,
}

impl AnnotatedVideo {
    /// Starts the thread that draws; it ends when the video is dropped.
    pub fn start() -> Arc<Self> {
        let (drawn, _) = watch::channel(Arc::default());
        let video = Arc::new(Self { latest: Mutex::new(None), changed: Condvar::new(), drawn });
        let of_thread = Arc::downgrade(&video);
        std::thread::spawn(move || {
            lower_priority();
            while let Some(video) = of_thread.upgrade() {
                video.draw_next();
            }
        });
        video
    }

    /// Hands over a frame, if somebody watches; it replaces one that was not drawn yet.
    pub fn offer(&self, frame: &Arc<Frame>, measurement: &Measurement, eye: &Arc<Eye>) {
        if self.drawn.receiver_count() > 0 {
            let to_draw = ToDraw { frame: Arc::clone(frame), measurement: measurement.clone(), eye: Arc::clone(eye) };
            *self.latest.lock().unwrap_or_else(PoisonError::into_inner) = Some(to_draw);
            self.changed.notify_all();
        }
    }

    /// The pictures from now on; a slow reader misses some.
    pub fn watch(&self) -> watch::Receiver<Arc<Vec<u8>>> {
        self.drawn.subscribe()
    }

    fn draw_next(&self) {
        let latest = self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self.changed.wait_timeout_while(latest, TIMEOUT, |latest| latest.is_none());
        let Some(to_draw) = waited.unwrap_or_else(PoisonError::into_inner).0.take() else { return };
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
        let picture = overlay(&self.frame, &self.measurement, shape.as_ref());
        if picture.width() <= MAX_WIDTH {
            return picture;
        }
        let height = (f64::from(picture.height()) * f64::from(MAX_WIDTH) / f64::from(picture.width())) as u32;
        resize(&picture, MAX_WIDTH, height.max(1), FilterType::Triangle)
    }
}
