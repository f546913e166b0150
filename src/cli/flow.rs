//! The flow of frames: read and measured on all cores, handed on in order, only a few in memory at a time.

use super::console::Console;
use super::shard::Shard;
use super::trackers::OpenTracker;
use super::views::OpenView;
use crate::camera::{Frame, FrameSource, Lens, SourceFrame};
use crate::measure::{Eye, FrameMeasurement, fused};
use crate::observation::{EncoderReading, Measurement, Status};
use crate::robot::Model;
use crate::{Error, Result};
use nalgebra::Vector2;
use serde::Serialize;
use std::collections::VecDeque;
use std::iter::Peekable;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError, mpsc};
use std::time::{Duration, Instant};
use tracing::{debug, info, info_span};

/// How long measuring took, and what for.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Throughput {
    /// Wall time, s.
    pub seconds: f64,
    /// Frames per second of wall time, end to end.
    pub frames_per_second: f64,
    /// Share of the computing time that reading and decoding the pictures took, 0 to 1.
    pub decoding_share: f64,
}

/// Which frames are measured, and how.
pub struct Flow<'a> {
    /// The views.
    pub views: &'a [OpenView],
    /// The trackers, whose poses are measured already.
    pub trackers: &'a [OpenTracker],
    /// The encoder log in order of its index, which gives times to frames that have none of their own; empty without a log.
    pub encoders: &'a [EncoderReading],
    /// The model by which a reading tells about which bend to expect.
    pub model: &'a Model,
    /// Whether a camera that moves is followed from frame to frame.
    pub follow: bool,
    /// The part of the frames that is measured.
    pub shard: Shard,
    /// Frames up to this index are measured already.
    pub after: Option<u64>,
}

/// A measured index, while its frames are still in memory.
pub struct MeasuredFrames<'a> {
    /// Which one of the whole sequence, from 0.
    pub rank: usize,
    /// How many there are in the whole sequence; `None` where only reading a video to its end would tell.
    pub count: Option<usize>,
    /// What was measured.
    pub measurement: &'a Measurement,
    /// The frames of this index that could be read.
    pub frames: Vec<(&'a OpenView, &'a Frame)>,
}

/// What came through.
pub struct Flowed {
    /// Indices in the whole sequence.
    pub count: usize,
    /// How fast those were measured that had to be.
    pub throughput: Throughput,
}

impl Flow<'_> {
    /// Measures every frame of every view, a few at a time in parallel: one row an index, handed to `each` in order; what
    /// several views saw under the same index is put together. `draw` is called before that, in parallel, while the frames are
    /// still there.
    ///
    /// A frame has the time that its source or else the encoder log tells.
    ///
    /// # Errors
    /// A folder of frames that went away, a video that cannot be opened any more; what `draw` and `each` say; a caller that ended the work.
    pub fn run(
        &self,
        console: &Console,
        draw: impl Fn(&MeasuredFrames) -> Result<()> + Sync,
        mut each: impl FnMut(Measurement) -> Result<()>,
    ) -> Result<Flowed> {
        let _stage = info_span!("measure").entered();
        let (clocks, unreadable) = (Clocks::default(), Unreadable::default());
        let start = Instant::now();
        let expected = self.count()?;
        let bar = console.progress(expected, "measuring");
        let (mut count, mut measured) = (0, 0_usize);
        let mut eyes: Vec<Eye> = self.views.iter().map(|view| view.eye().clone()).collect();
        let sets = self.sets()?.filter_map(|FrameSet { index, frames }| {
            let rank = count;
            count += 1;
            let wanted = self.shard.has(rank) && self.after.is_none_or(|last| index > last);
            if !wanted {
                bar.inc(1);
            }
            // The position of a followed camera depends on all frames before.
            let prepared = (wanted || self.follow).then(|| self.prepare(&mut eyes, frames, (&clocks, &unreadable)));
            prepared.filter(|_| wanted).map(|prepared| (rank, index, prepared))
        });
        let work = |(rank, index, prepared): (usize, u64, Result<Vec<Prepared>>)| {
            let reading = self.reading(index).map(|reading| reading.beside_resting_neighbours(self.model));
            let bend = reading.and_then(|reading| self.model.forward_bend(&reading.q_mm).ok());
            let see = |prepared| self.see(prepared, bend, (&clocks, &unreadable));
            let seen = prepared?.into_iter().map(see).collect::<Result<Vec<_>>>()?;
            let measurement = self.row(index, &seen);
            let frames = seen.iter().filter_map(|seen| Some((seen.view, seen.frame.as_ref()?))).collect();
            draw(&MeasuredFrames { rank, count: expected, measurement: &measurement, frames })?;
            Ok((measurement, seen.len()))
        };
        in_order(sets, work, |(measurement, frames)| {
            console.require_wanted()?;
            measured += frames;
            bar.inc(1);
            let theta_deg = measurement.measured.map(|measured| measured.configuration.theta_deg());
            debug!(index = measurement.index, status = %measurement.status, theta_deg, "measured");
            each(measurement)
        })?;
        bar.finish_and_clear();
        console.warn(unreadable.told());
        info!(frames = measured, of = count, "measured");
        Ok(Flowed { count, throughput: clocks.throughput(measured, start.elapsed()) })
    }

    /// The frames of one index, made ready to be measured in parallel: where a camera is followed it is found here, frame after
    /// frame.
    ///
    /// # Errors
    /// A folder of frames that is gone.
    fn prepare(
        &self,
        eyes: &mut [Eye],
        frames: Vec<(usize, SourceFrame)>,
        notes: (&Clocks, &Unreadable),
    ) -> Result<Vec<Prepared>> {
        let prepare = |(view, source): (usize, SourceFrame)| {
            let time_s = source.time_s;
            let ready = if self.follow { followed(&mut eyes[view], source, notes)? } else { Ready::Unread(source) };
            Ok(Prepared { view, time_s, ready })
        };
        frames.into_iter().map(prepare).collect()
    }

    /// The frames of all views, and the poses of all trackers, index by index.
    fn sets(&self) -> Result<FrameSets<'_>> {
        FrameSets::open(self.views, self.trackers)
    }

    /// How many indices there are; `None` where a video does not tell.
    fn count(&self) -> Result<Option<usize>> {
        if self.views.iter().all(|view| matches!(view.source(), FrameSource::Pictures(_) | FrameSource::Stack(..))) {
            return Ok(Some(self.sets()?.count()));
        }
        let counts: Result<Vec<_>> = self.views.iter().map(|view| view.source().count()).collect();
        Ok(counts?.into_iter().max().flatten())
    }

    /// The encoder reading of an index.
    fn reading(&self, index: u64) -> Option<&EncoderReading> {
        self.encoders.binary_search_by_key(&index, |reading| reading.index).ok().map(|place| &self.encoders[place])
    }

    /// What one view saw: reads and measures its frame, where a reading tells which bend vector to expect from there.
    fn see(
        &self,
        Prepared { view, time_s, ready }: Prepared,
        expected: Option<Vector2<f64>>,
        (clocks, unreadable): (&Clocks, &Unreadable),
    ) -> Result<Seen<'_>> {
        let view = &self.views[view];
        let measure = |eye: &Eye, frame: Frame| {
            let measurement = clocks.measuring.time(|| match expected {
                Some(expected) => eye.measure_expected(&frame, expected),
                None => eye.measure(&frame),
            });
            (Some(frame), measurement)
        };
        let (frame, measurement) = match ready {
            Ready::Unread(source) if is_far_too_large(&source, view.eye().lens()) => {
                (None, without_angles(Status::WrongSize))
            }
            Ready::Unread(source) => match clocks.reading.time(|| read(source, view.eye().lens(), unreadable))? {
                Some(frame) => measure(view.eye(), frame),
                None => (None, without_angles(Status::Unreadable)),
            },
            Ready::Found(eye, frame) => measure(&eye, frame),
            Ready::Lost(status, frame) => (frame, without_angles(status)),
        };
        Ok(Seen { view, time_s, frame, measurement })
    }

    /// The row of one index from what its views saw.
    fn row(&self, index: u64, seen: &[Seen]) -> Measurement {
        let tracked: Vec<(&OpenTracker, f64, &FrameMeasurement)> =
            self.trackers.iter().filter_map(|tracker| tracker.at(index)).collect();
        let of_views = seen.iter().map(|s| (s.view.name(), &s.measurement));
        let of_trackers = tracked.iter().map(|(tracker, _, measurement)| (tracker.name.as_str(), *measurement));
        let all: Vec<(&str, &FrameMeasurement)> = of_views.chain(of_trackers).collect();
        let measurements: Vec<FrameMeasurement> = all.iter().map(|(_, measurement)| (*measurement).clone()).collect();
        let fused = fused(&measurements);
        let answered =
            |(_, measurement): &&(&str, &FrameMeasurement)| fused.measured.is_none() || measurement.measured.is_some();
        let names: Vec<&str> = all.iter().filter(answered).map(|(name, _)| *name).collect();
        let logged = || Some(self.reading(index)?.time_s);
        let told = seen.iter().find_map(|s| s.time_s).or_else(|| tracked.first().map(|(_, time_s, _)| *time_s));
        let time_s = told.or_else(logged);
        let view = Some(names.join("+"));
        fused.row(index, time_s, view)
    }
}

/// One view's frame on its way to be measured.
struct Prepared {
    /// Number of the view.
    view: usize,
    time_s: Option<f64>,
    ready: Ready,
}

/// How far a frame is on its way.
enum Ready {
    /// Not read yet.
    Unread(SourceFrame),
    /// Read, and the camera was followed to it.
    Found(Box<Eye>, Frame),
    /// Followed in vain, with the frame if it could be read.
    Lost(Status, Option<Frame>),
}

/// One view's part of a measurement.
struct Seen<'a> {
    view: &'a OpenView,
    time_s: Option<f64>,
    frame: Option<Frame>,
    measurement: FrameMeasurement,
}

fn without_angles(status: Status) -> FrameMeasurement {
    FrameMeasurement { status, measured: None, bend: None, quality: None }
}

/// Finds the camera in a view's next frame, from where it was in the last one in which it was found.
fn followed(eye: &mut Eye, source: SourceFrame, (clocks, unreadable): (&Clocks, &Unreadable)) -> Result<Ready> {
    let Some(frame) = clocks.reading.time(|| read(source, eye.lens(), unreadable))? else {
        return Ok(Ready::Lost(Status::Unreadable, None));
    };
    Ok(match clocks.measuring.time(|| eye.following(&frame)) {
        Ok(there) => {
            *eye = there.clone();
            Ready::Found(Box::new(there), frame)
        }
        Err(status) => Ready::Lost(status, Some(frame)),
    })
}

/// Whether a picture has so many more pixels than the camera that it is not worth decoding to say so. Smaller ones are decoded, and
/// drawn in the report.
fn is_far_too_large(source: &SourceFrame, lens: &Lens) -> bool {
    /// Times the camera's pixels. Convention: a resource limit.
    const MOST_TIMES: u64 = 4;
    let pixels = |(width, height)| u64::from(width) * u64::from(height);
    source.size().is_some_and(|size| pixels(size) > MOST_TIMES * pixels((lens.width, lens.height)))
}

/// The frame; `None` where it cannot be read, which costs its row only.
///
/// # Errors
/// The folder that it was in is gone: then all frames to come would be lost with it.
fn read(source: SourceFrame, lens: &Lens, unreadable: &Unreadable) -> Result<Option<Frame>> {
    let folder = match source.path.parent() {
        Some(parent) if parent != Path::new("") => parent.to_owned(),
        _ => Path::new(".").to_owned(),
    };
    match source.read_for(lens) {
        Ok(frame) => Ok(Some(frame)),
        Err(why) => {
            if matches!(why, Error::Io { .. }) {
                std::fs::read_dir(&folder).map_err(Error::io(&folder, "read any more frames, the folder is gone:"))?;
            }
            unreadable.note(&why);
            Ok(None)
        }
    }
}

/// Why frames could not be read: the first reasons, and how many there are.
#[derive(Default)]
struct Unreadable(Mutex<(usize, Vec<String>)>);

impl Unreadable {
    /// Reasons that are told. Convention: as many as a person reads.
    const MOST: usize = 3;

    fn note(&self, why: &Error) {
        let mut noted = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        noted.0 += 1;
        if noted.1.len() < Self::MOST {
            noted.1.push(why.to_string());
        }
    }

    fn told(self) -> Vec<String> {
        let (count, mut reasons) = self.0.into_inner().unwrap_or_else(PoisonError::into_inner);
        if count > reasons.len() {
            reasons.push(format!("and {} more frames that cannot be read", count - reasons.len()));
        }
        reasons
    }
}

/// The frames of one index, each with the number of its view.
struct FrameSet {
    index: u64,
    frames: Vec<(usize, SourceFrame)>,
}

/// The frames of all views, index by index; also indices of which only trackers have a pose.
struct FrameSets<'a> {
    views: Vec<Peekable<Box<dyn Iterator<Item = SourceFrame> + Send + 'a>>>,
    trackers: Vec<Peekable<Box<dyn Iterator<Item = u64> + Send + 'a>>>,
}

impl<'a> FrameSets<'a> {
    fn open(views: &'a [OpenView], trackers: &'a [OpenTracker]) -> Result<Self> {
        let views: Result<Vec<_>> = views.iter().map(|view| Ok(view.source().frames()?.peekable())).collect();
        Ok(Self { views: views?, trackers: trackers.iter().map(|tracker| tracker.indices().peekable()).collect() })
    }
}

impl Iterator for FrameSets<'_> {
    type Item = FrameSet;

    fn next(&mut self) -> Option<FrameSet> {
        let of_views = self.views.iter_mut().filter_map(|frames| Some(frames.peek()?.index));
        let of_trackers = self.trackers.iter_mut().filter_map(|indices| indices.peek().copied());
        let index = of_views.chain(of_trackers).min()?;
        for indices in &mut self.trackers {
            indices.next_if_eq(&index);
        }
        let of_this = |(view, frames): (usize, &mut Peekable<_>)| {
            Some((view, frames.next_if(|frame: &SourceFrame| frame.index == index)?))
        };
        Some(FrameSet { index, frames: self.views.iter_mut().enumerate().filter_map(of_this).collect() })
    }
}

/// Works on items in parallel and hands the results on in order. Two items a thread are in flight, no more, so that memory does
/// not grow and a slow one keeps nobody waiting.
///
/// # Errors
/// The first that `work` or `each` gives; items in flight then are finished and forgotten.
fn in_order<T: Send, R: Send>(
    mut items: impl Iterator<Item = T>,
    work: impl Fn(T) -> Result<R> + Sync,
    mut each: impl FnMut(R) -> Result<()>,
) -> Result<()> {
    let in_flight = 2 * rayon::current_num_threads();
    rayon::in_place_scope(|scope| {
        let mut waiting = VecDeque::new();
        loop {
            while waiting.len() < in_flight
                && let Some(item) = items.next()
            {
                let (sender, receiver) = mpsc::sync_channel(1);
                let work = &work;
                // Nobody waits for it any more after an error.
                scope.spawn(move |_| drop(sender.send(work(item))));
                waiting.push_back(receiver);
            }
            // A task that panicked sends nothing; the scope hands its panic on.
            let Some(Ok(result)) = waiting.pop_front().map(|receiver| receiver.recv()) else { return Ok(()) };
            each(result?)?;
        }
    })
}

/// The time that reading and measuring took, over all threads.
#[derive(Default)]
struct Clocks {
    reading: Clock,
    measuring: Clock,
}

impl Clocks {
    fn throughput(&self, frames: usize, wall: Duration) -> Throughput {
        let (seconds, reading) = (wall.as_secs_f64(), self.reading.seconds());
        let busy = reading + self.measuring.seconds();
        Throughput {
            seconds,
            frames_per_second: frames as f64 / seconds,
            decoding_share: if busy > 0.0 { reading / busy } else { 0.0 },
        }
    }
}

/// Adds up time over threads.
#[derive(Default)]
struct Clock {
    nanoseconds: AtomicU64,
}

impl Clock {
    fn time<T>(&self, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        let nanoseconds = u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.nanoseconds.fetch_add(nanoseconds, Ordering::Relaxed);
        result
    }

    fn seconds(&self) -> f64 {
        Duration::from_nanos(self.nanoseconds.load(Ordering::Relaxed)).as_secs_f64()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicUsize;

    #[test]
    fn results_come_in_order_and_only_a_few_are_begun_ahead() {
        let (begun, mut handed_on) = (AtomicUsize::new(0), 0);
        let work = |i: u64| {
            begun.fetch_add(1, Ordering::SeqCst);
            // Later ones are done sooner.
            std::thread::sleep(Duration::from_micros(3000 / (1 + i % 5)));
            Ok(i)
        };
        in_order(0..50, work, |i| {
            assert_eq!(i, handed_on);
            handed_on += 1;
            assert!(begun.load(Ordering::SeqCst) <= handed_on as usize + 2 * rayon::current_num_threads());
            Ok(())
        })
        .unwrap();
        assert_eq!(handed_on, 50);
    }

    #[test]
    fn the_first_error_ends_the_flow_and_what_came_before_it_is_handed_on() {
        let mut handed_on = Vec::new();
        let work = |i: u64| if i == 7 { Err(Error::Scene("seven")) } else { Ok(i) };
        let error = in_order(0.., work, |i| {
            handed_on.push(i);
            Ok(())
        });
        assert_eq!((error.unwrap_err().to_string(), handed_on), ("seven".to_owned(), (0..7).collect()));
    }
}
