//! `live` as its users meet it. There is no camera on a test machine, so the tests bring their own.

mod lab;
#[cfg(feature = "opencv")]
mod page;
mod sequence;
#[cfg(feature = "opencv")]
mod streams;
