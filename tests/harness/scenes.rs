//! Rendered frames whose truth is known, and the eye of a rig that was calibrated on one of them.

use image::{DynamicImage, RgbImage};
use snakeloop::camera::Frame;
use snakeloop::geometry::Configuration;
use snakeloop::measure::{Eye, Rig, RigError, RigOptions, calibrate_rig};
use snakeloop::simulate::render::render;
use snakeloop::simulate::scene::{Light, Pattern, Scene, Sensor, Viewpoint};

pub const STRAIGHT: Configuration = Configuration { theta: 0.0, delta: 0.0 };

/// A picture as the eye takes it.
pub fn frame_of(picture: RgbImage) -> Frame {
    Frame::from_image(DynamicImage::ImageRgb8(picture)).unwrap()
}

/// What the scene's camera sees of a snake bent to ψ.
pub fn frame(scene: &Scene, psi: Configuration, seed: u64) -> Frame {
    frame_of(render(scene, psi, seed))
}

/// A noisy laboratory: a tilted camera with distortion, a light gradient, a shadow, some blur.
pub fn laboratory() -> Scene {
    let mut scene = Scene { sensor: Sensor { rays_per_pixel: 4, blur_px: 0.8, noise: 3.0 }, ..Scene::default() };
    scene.lens.distortion[0] = -0.12;
    scene.view = Viewpoint { yaw_deg: -6.0, pitch_deg: 4.0, roll_deg: -3.0, ..scene.view };
    scene.light = Light { gradient: [0.15, -0.1], shadow: 0.3, shadow_blur_mm: 1.5, ..scene.light };
    scene
}

/// The same with a checkerboard of 2 mm squares, lighter than a dark snake.
pub fn checkered_laboratory() -> Scene {
    let mut scene = laboratory();
    scene.paper.pattern = Pattern::Checkerboard { square_mm: 2.0, colour: [150.0, 150.0, 155.0] };
    scene.paper.colour = [230.0, 230.0, 226.0];
    scene.surface.colour = [40.0, 40.0, 42.0];
    scene
}

/// The same scene in a picture of 1/divisor of the width and the height. Pixel centres are at integers.
pub fn smaller(mut scene: Scene, divisor: u32) -> Scene {
    scene.lens.width /= divisor;
    scene.lens.height /= divisor;
    let divisor = f64::from(divisor);
    scene.lens.focal_px /= divisor;
    scene.lens.centre_px = scene.lens.centre_px.map(|c| (c - (divisor - 1.0) / 2.0) / divisor);
    scene
}

/// What a user measures on the scene's grid target and tells `calibrate rig`.
pub fn rig_options(scene: &Scene) -> RigOptions {
    let grid_pitch_mm = match &scene.paper.pattern {
        Pattern::Blank => f64::NAN,
        Pattern::GraphPaper { lines } => lines.iter().map(|l| l.pitch_mm).fold(f64::INFINITY, f64::min),
        Pattern::Checkerboard { square_mm, .. } => *square_mm,
    };
    RigOptions { grid_pitch_mm, standoff_mm: scene.paper.standoff_mm, delta_offset: 0.0 }
}

/// The rig of the scene's straight picture.
pub fn rig(scene: &Scene, seed: u64) -> Result<Rig, RigError> {
    calibrate_rig(&frame(scene, STRAIGHT, seed), &scene.lens, &scene.robot, &rig_options(scene))
}

/// The eye before the scene with this rig.
pub fn eye_with(scene: &Scene, rig: Rig) -> Eye {
    Eye::new(scene.lens.clone(), rig, scene.robot.clone())
}

/// The eye before the scene with the rig of its straight picture.
pub fn eye(scene: &Scene) -> Eye {
    eye_with(scene, rig(scene, 7).unwrap())
}
