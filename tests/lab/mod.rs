//! The rendered lab that the tests of the eye share.

use image::DynamicImage;
use snakeloop::camera::Frame;
use snakeloop::geometry::Configuration;
use snakeloop::simulate::render::render;
use snakeloop::simulate::scene::{Light, Scene, Sensor, Viewpoint};

pub fn frame(scene: &Scene, psi: Configuration, seed: u64) -> Frame {
    Frame::from_image(DynamicImage::ImageRgb8(render(scene, psi, seed))).unwrap()
}

/// A noisy lab: a tilted camera with distortion, a gradient, a shadow, some blur.
pub fn lab() -> Scene {
    let mut scene = Scene { sensor: Sensor { rays_per_pixel: 4, blur_px: 0.8, noise: 3.0 }, ..Scene::default() };
    scene.lens.distortion[0] = -0.12;
    scene.view = Viewpoint { yaw_deg: -6.0, pitch_deg: 4.0, roll_deg: -3.0, ..scene.view };
    scene.light = Light { gradient: [0.15, -0.1], shadow: 0.3, shadow_blur_mm: 1.5, ..scene.light };
    scene
}
