//! What a user can tell a running loop, and how it answers.

use std::sync::mpsc::{Receiver, Sender, channel};
use tokio::sync::oneshot;

/// What the loop can be told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// Measure, or let frames pass.
    Pause(bool),
    /// Take the newest frame for a picture of the unbent snake and calibrate the rig anew.
    Reference,
    /// Forget η and λ.
    Reset,
    /// Write model and table now.
    Save,
}

/// What came of a command, in words; an error where it was refused.
pub type Answer = std::result::Result<String, String>;

/// A command and where its answer goes.
pub type Request = (Command, oneshot::Sender<Answer>);

/// A handle to tell a loop something.
#[derive(Debug, Clone)]
pub struct Commands(Sender<Request>);

impl Commands {
    /// A handle, and the loop's end of it.
    pub fn channel() -> (Self, Receiver<Request>) {
        let (sender, receiver) = channel();
        (Self(sender), receiver)
    }

    /// Sends a command; the answer comes through the channel, unless the run is over.
    pub fn send(&self, command: Command) -> oneshot::Receiver<Answer> {
        let (answer, answered) = oneshot::channel();
        let _ = self.0.send((command, answer));
        answered
    }
}
