//! `live` as its users meet it. There is no camera on a test machine, so the tests bring their own.

mod delay;
mod faults;
mod fixture;
mod kills;
#[cfg(feature = "opencv")]
mod page;
mod ros2;
mod rtsp;
mod sequence;
mod streams;
#[cfg(feature = "opencv")]
mod video;
