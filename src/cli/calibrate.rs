//! `calibrate`: what must be known once, before anything is measured.

mod camera;
mod friction;
mod rig;

pub(super) use camera::corners;

use super::console::Console;
use crate::Result;
use crate::cli::failure::Failure;

/// Find what does not change from run to run: the camera, the rig, the friction
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop calibrate friction calib/friction.csv")]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    Camera(camera::Args),
    Rig(rig::Args),
    Friction(friction::Args),
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        match &self.what {
            What::Camera(args) => args.run(console),
            What::Rig(args) => args.run(console),
            What::Friction(args) => args.run(console),
        }
    }
}
