//! ROS 2 in a build without it: everything is refused.

use super::annotated_video::AnnotatedVideo;
use super::shared_state::SharedState;
use super::stream::{FrameStream, ReadingStream};
use crate::camera::Lens;
use crate::error::{Error, Result};
use std::sync::Arc;

/// A participant that can never join a domain.
#[derive(Debug, Clone)]
pub enum Node {}

impl Node {
    /// Always refuses.
    ///
    /// # Errors
    /// That this build has no ROS 2.
    pub fn join(_: u16) -> Result<Self> {
        let message = "this build has no ROS 2: build with --features ros2".into();
        Err(Error::Unavailable { what: "--ros2".into(), message })
    }

    /// Never called.
    ///
    /// # Errors
    /// None.
    pub fn pictures(&self, _: &str) -> Result<Box<dyn FrameStream>> {
        match *self {}
    }

    /// Never called.
    ///
    /// # Errors
    /// None.
    pub fn joints(&self, _: &str, _: &[String], _: f64) -> Result<Box<dyn ReadingStream>> {
        match *self {}
    }

    /// Never called.
    ///
    /// # Errors
    /// None.
    pub fn lens_beside(&self, _: &str) -> Result<Lens> {
        match *self {}
    }
}

/// What never publishes anything.
#[derive(Debug)]
pub enum Sink {}

impl Sink {
    /// Never called.
    ///
    /// # Errors
    /// None.
    pub fn start(node: &Node, _: Arc<SharedState>, _: Arc<AnnotatedVideo>) -> Result<Self> {
        match *node {}
    }

    /// Never called.
    pub fn finish(self) {
        match self {}
    }
}
