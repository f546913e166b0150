//! The eye of a running loop, and its renewal from a new picture of the unbent snake.

use crate::camera::{Frame, Lens};
use crate::measure::{Eye, RigOptions, calibrate_rig};
use crate::robot::Robot;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

/// The eye that measures, and what a new one is made from.
#[derive(Debug)]
pub struct RenewableEye {
    eye: Mutex<Arc<Eye>>,
    lens: Lens,
    robot: Robot,
    rig_options: RigOptions,
    output: PathBuf,
}

impl RenewableEye {
    /// Begins with an eye. A new rig is written into the folder `output`.
    pub fn new(eye: Eye, lens: Lens, robot: Robot, rig_options: RigOptions, output: PathBuf) -> Self {
        Self { eye: Mutex::new(Arc::new(eye)), lens, robot, rig_options, output }
    }

    /// The eye as it is now.
    pub fn get(&self) -> Arc<Eye> {
        Arc::clone(&self.eye.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Calibrates the rig on a frame of the unbent snake, writes rig.toml and measures with it from now on.
    ///
    /// # Errors
    /// A frame in which grid or snake are not found as they should be; a file that cannot be written.
    pub fn renew(&self, frame: &Frame) -> std::result::Result<(), String> {
        let rig =
            calibrate_rig(frame, &self.lens, &self.robot, &self.rig_options).map_err(|error| error.to_string())?;
        rig.write(&self.output.join("rig.toml")).map_err(|error| error.to_string())?;
        let eye = Eye::new(self.lens.clone(), rig, self.robot.clone());
        // Frames that come meanwhile are measured with the eye before.
        eye.prepare();
        *self.eye.lock().unwrap_or_else(PoisonError::into_inner) = Arc::new(eye);
        Ok(())
    }
}
