//! The annotated video: drawn beside the loop, only while somebody watches, and no faster than is pleasant.

use super::quiet::be_quiet;
use crate::camera::Frame;
use crate::measure::Eye;
use crate::observation::Measurement;
use crate::report::overlay::{Shape, overlay};
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{FilterType, resize};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// No more than this many pictures a second are drawn.
const MOST_FPS: f64 = 8.0;
/// Wider frames are made smaller, px.
const MOST_WIDTH: u32 = 960;

/// A frame and what was measured in it.
struct Seen {
    frame: Arc<Frame>,
    measurement: Measurement,
    eye: Arc<Eye>,
}

/// Where the loop leaves frames and watchers fetch pictures (JPEG).
pub struct Pictures {
    seen: Mutex<Option<Seen>>,
    changed: Condvar,
    drawn: watch::Sender<Arc<Vec<u8>>>,
}

impl Pictures {
    /// Starts the thread that draws; it ends with the program.
    pub fn start() -> Arc<Self> {
        let (drawn, _) = watch::channel(Arc::default());
        let pictures = Arc::new(Self { seen: Mutex::new(None), changed: Condvar::new(), drawn });
        let theirs = Arc::downgrade(&pictures);
        std::thread::spawn(move || {
            be_quiet();
            while let Some(pictures) = theirs.upgrade() {
                pictures.draw_next();
            }
        });
        pictures
    }

    /// Hands over a frame, if somebody watches; the latest counts.
    pub fn offer(&self, frame: &Arc<Frame>, measurement: &Measurement, eye: &Arc<Eye>) {
        if self.drawn.receiver_count() > 0 {
            let seen = Seen { frame: Arc::clone(frame), measurement: measurement.clone(), eye: Arc::clone(eye) };
            *self.seen.lock().unwrap_or_else(PoisonError::into_inner) = Some(seen);
            self.changed.notify_all();
        }
    }

    /// The pictures from now on; a slow watcher misses some.
    pub fn watch(&self) -> watch::Receiver<Arc<Vec<u8>>> {
        self.drawn.subscribe()
    }

    fn draw_next(&self) {
        let seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        let nothing = |seen: &mut Option<Seen>| seen.is_none();
        let waited = self.changed.wait_timeout_while(seen, Duration::from_millis(200), nothing);
        let Some(Seen { frame, measurement, eye }) = waited.unwrap_or_else(PoisonError::into_inner).0.take() else {
            return;
        };
        let began = Instant::now();
        let shape = measurement.measured.map(|measured| Shape::of(&eye.projection(), measured.configuration));
        let picture = overlay(&frame, &measurement, shape.as_ref());
        let picture = if picture.width() > MOST_WIDTH {
            let height = (f64::from(picture.height()) * f64::from(MOST_WIDTH) / f64::from(picture.width())) as u32;
            resize(&picture, MOST_WIDTH, height.max(1), FilterType::Triangle)
        } else {
            picture
        };
        let mut jpeg = Vec::new();
        if JpegEncoder::new_with_quality(&mut jpeg, 80).encode_image(&picture).is_ok() {
            self.drawn.send_replace(Arc::new(jpeg));
        }
        std::thread::sleep(Duration::from_secs_f64(1.0 / MOST_FPS).saturating_sub(began.elapsed()));
    }
}
