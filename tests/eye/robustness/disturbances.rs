//! What may go wrong in one frame after the rig was calibrated.

use crate::rigs::{self, Random};
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use nalgebra::{Translation3, Vector2};
use snakeloop::geometry::Configuration;
use snakeloop::simulate::render::{coverage, render};
use snakeloop::simulate::scene::{Scene, Stain, Viewpoint, Wire};

/// One way to spoil a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Disturbance {
    None,
    NoSnake,
    /// The outer half is behind a sheet.
    HalfHidden,
    /// The outer half is cut off.
    HalfMissing,
    TwoSnakes,
    Hand,
    White,
    Black,
    Wires,
    Highlight,
    ShadowEdge,
    Stains,
    HeavyNoise,
    TooBright,
    TooDark,
    Blur,
    Jpeg,
    OtherLight,
    /// A wire, blur, noise, a stain, another light and JPEG at once.
    Combined,
}

impl Disturbance {
    pub const ALL: [Self; 19] = [
        Self::None,
        Self::NoSnake,
        Self::HalfHidden,
        Self::HalfMissing,
        Self::TwoSnakes,
        Self::Hand,
        Self::White,
        Self::Black,
        Self::Wires,
        Self::Highlight,
        Self::ShadowEdge,
        Self::Stains,
        Self::HeavyNoise,
        Self::TooBright,
        Self::TooDark,
        Self::Blur,
        Self::Jpeg,
        Self::OtherLight,
        Self::Combined,
    ];
}

/// A spoilt frame of a snake bent to ψ, and the bend it shows: `None` where it shows none.
pub fn disturbed(
    scene: &Scene,
    psi: Configuration,
    disturbance: Disturbance,
    random: &mut Random,
) -> (RgbImage, Option<Configuration>) {
    let mut scene = scene.clone();
    let seed = random.between(0.0, 1e9) as u64;
    let (width, height) = (f64::from(scene.lens.width), f64::from(scene.lens.height));
    let truth = Some(psi);
    match disturbance {
        Disturbance::None => {}
        Disturbance::NoSnake => {
            let away = shifted(&scene, [300.0, 0.0]);
            return (render(&away, psi, seed), None);
        }
        Disturbance::HalfHidden => scene.wires.push(sheet(&scene, psi, random)),
        Disturbance::HalfMissing => {
            let whole = scene.robot.clone();
            scene.robot.length_mm = whole.length_mm / 2.0;
            scene.robot.body.spacer_disk_count = whole.body.spacer_disk_count / 2;
            // The same curvature as the whole snake's.
            return (render(&scene, Configuration::new(psi.theta / 2.0, psi.delta), seed), truth);
        }
        Disturbance::TwoSnakes => return (two_snakes(&scene, psi, seed, random), truth),
        Disturbance::Hand => scene.wires.extend(hand(&scene, random)),
        Disturbance::White => return (RgbImage::from_pixel(width as u32, height as u32, image::Rgb([255; 3])), None),
        Disturbance::Black => return (RgbImage::new(width as u32, height as u32), None),
        Disturbance::Wires => {
            let count = random.between(1.0, 4.0) as usize;
            scene.wires.extend((0..count).map(|_| wire(&scene, random)).collect::<Vec<_>>());
        }
        Disturbance::Highlight => {
            scene.surface.highlight = random.between(0.8, 3.0);
            scene.surface.shininess = random.between(2.0, 40.0);
            scene.light.towards_lamp = [random.between(-0.5, 0.5), -1.0, random.between(-0.5, 0.5)];
        }
        Disturbance::ShadowEdge => {
            let mut picture = render(&scene, psi, seed);
            shadow_edge(&mut picture, random);
            return (picture, truth);
        }
        Disturbance::Stains => {
            let count = random.between(1.0, 6.0) as usize;
            scene.paper.stains = (0..count).map(|_| stain(random)).collect();
        }
        Disturbance::HeavyNoise => scene.sensor.noise = random.between(10.0, 50.0),
        Disturbance::TooBright => {
            let mut picture = render(&scene, psi, seed);
            gain(&mut picture, random.between(1.3, 4.0));
            return (picture, truth);
        }
        Disturbance::TooDark => {
            let mut picture = render(&scene, psi, seed);
            gain(&mut picture, random.between(0.03, 0.6));
            return (picture, truth);
        }
        Disturbance::Blur => scene.sensor.blur_px = width / 1280.0 * random.between(2.0, 8.0),
        Disturbance::Jpeg => {
            let quality = random.between(10.0, 70.0) as u8;
            return (through_jpeg(&render(&scene, psi, seed), quality), truth);
        }
        Disturbance::OtherLight => scene.light = rigs::light(random),
        Disturbance::Combined => {
            scene.wires.push(wire(&scene, random));
            scene.paper.stains = vec![stain(random)];
            scene.sensor.blur_px = width / 1280.0 * random.between(1.0, 3.0);
            scene.sensor.noise = random.between(4.0, 15.0);
            scene.light.gradient = [random.between(-0.4, 0.4), random.between(-0.4, 0.4)];
            let quality = random.between(40.0, 90.0) as u8;
            return (through_jpeg(&render(&scene, psi, seed), quality), truth);
        }
    }
    (render(&scene, psi, seed), truth)
}

/// The scene with its snake moved along x_b and z_b before the same paper, seen by the same camera.
fn shifted(scene: &Scene, by_mm: [f64; 2]) -> Scene {
    let mut moved = scene.clone();
    let base_from_moved = Translation3::new(by_mm[0], 0.0, by_mm[1]);
    moved.view = Viewpoint::from_pose(&(scene.view.camera_from_base() * base_from_moved));
    for (origin, by) in moved.paper.origin_mm.iter_mut().zip(by_mm) {
        *origin -= by;
    }
    moved
}

/// A second snake beside the first, or across it.
fn two_snakes(scene: &Scene, psi: Configuration, seed: u64, random: &mut Random) -> RgbImage {
    let side = if random.chance(0.5) { 1.0 } else { -1.0 };
    let beside = shifted(scene, [side * random.between(5.0, 16.0), random.between(-6.0, 6.0)]);
    let other = Configuration::from_degrees(random.between(0.0, 95.0), random.between(-180.0, 180.0));
    let (mut picture, second) = (render(scene, psi, seed), render(&beside, other, seed + 1));
    let shares = coverage(&beside, other);
    for ((pixel, above), share) in picture.pixels_mut().zip(second.pixels()).zip(shares) {
        for (level, above) in pixel.0.iter_mut().zip(above.0) {
            *level = (f64::from(*level) * (1.0 - share) + f64::from(above) * share).round() as u8;
        }
    }
    picture
}

/// A broad stripe over the snake's outer half, of any colour.
fn sheet(scene: &Scene, psi: Configuration, random: &mut Random) -> Wire {
    let pixel = |share: f64| {
        let on_axis = scene.robot.frame_at(psi, share * scene.robot.length_mm);
        scene.lens.project(&(scene.view.camera_from_base() * on_axis * nalgebra::Point3::origin()))
    };
    let (middle, tip) = (pixel(random.between(0.35, 0.65)), pixel(1.0));
    let outward = (tip - middle).try_normalize(1.0).unwrap_or(-Vector2::y());
    let width_px = f64::from(scene.lens.width);
    let centre = middle + outward * width_px / 2.0;
    let along = Vector2::new(-outward.y, outward.x) * width_px;
    let grey = random.between(20.0, 245.0);
    let colour = if random.chance(0.3) { scene.surface.colour } else { [grey; 3] };
    Wire { from_px: (centre - along).into(), to_px: (centre + along).into(), width_px, colour }
}

fn wire(scene: &Scene, random: &mut Random) -> Wire {
    let (width, height) = (f64::from(scene.lens.width), f64::from(scene.lens.height));
    let grey = random.between(10.0, 230.0);
    let tint = random.between(-30.0, 30.0);
    let (left, right) = (random.between(0.0, height), random.between(0.0, height));
    let (top, bottom) = (random.between(0.2, 0.8) * width, random.between(0.2, 0.8) * width);
    let upright = random.chance(0.3);
    Wire {
        from_px: if upright { [top, 0.0] } else { [0.0, left] },
        to_px: if upright { [bottom, height] } else { [width, right] },
        width_px: width / 1280.0 * random.between(3.0, 30.0),
        colour: [grey + tint, grey, grey - tint].map(|v: f64| v.clamp(0.0, 255.0)),
    }
}

/// A palm with four fingers and a thumb that reaches into the picture from any side.
fn hand(scene: &Scene, random: &mut Random) -> Vec<Wire> {
    let (width, height) = (f64::from(scene.lens.width), f64::from(scene.lens.height));
    let unit = width / 1280.0;
    let around = random.between(0.0, std::f64::consts::TAU);
    let tone = random.between(0.35, 1.0);
    let colour = [232.0, 184.0, 150.0].map(|v| v * tone);
    let middle = Vector2::new(width * random.between(0.3, 0.7), height * random.between(0.2, 0.8));
    let reach = |angle: f64, length: f64| Vector2::new(angle.cos(), angle.sin()) * unit * length;
    let wrist = middle - reach(around, 900.0);
    let limb = |from: Vector2<f64>, to: Vector2<f64>, width_px: f64| Wire {
        from_px: from.into(),
        to_px: to.into(),
        width_px: unit * width_px,
        colour,
    };
    let mut limbs = vec![limb(wrist, middle, random.between(150.0, 240.0))];
    for (spread, length) in [(-0.9, 130.0), (-0.3, 210.0), (-0.1, 240.0), (0.12, 220.0), (0.35, 180.0)] {
        let spread = spread + random.between(-0.08, 0.08);
        limbs.push(limb(middle, middle + reach(around + spread, 1.3 * length), random.between(40.0, 60.0)));
    }
    limbs
}

fn stain(random: &mut Random) -> Stain {
    let dark = random.between(0.3, 0.95);
    Stain {
        centre_mm: [random.between(-20.0, 20.0), random.between(-5.0, 28.0)],
        radius_mm: random.between(1.0, 9.0),
        colour: [250.0 * dark, 235.0 * dark, random.between(120.0, 230.0) * dark],
    }
}

/// Darkens one side of a straight line, with a soft rim.
fn shadow_edge(picture: &mut RgbImage, random: &mut Random) {
    let (width, height) = (f64::from(picture.width()), f64::from(picture.height()));
    let around = random.between(0.0, std::f64::consts::TAU);
    let outward = Vector2::new(around.cos(), around.sin());
    let on_edge = Vector2::new(width * random.between(0.3, 0.7), height * random.between(0.2, 0.8));
    let (light, softness) = (random.between(0.3, 0.8), width / 1280.0 * random.between(1.0, 25.0));
    for (x, y, pixel) in picture.enumerate_pixels_mut() {
        let beyond = outward.dot(&(Vector2::new(f64::from(x), f64::from(y)) - on_edge)) / softness;
        let share = (0.5 + beyond).clamp(0.0, 1.0);
        pixel.0.iter_mut().for_each(|v| *v = (f64::from(*v) * (1.0 - share * (1.0 - light))).round() as u8);
    }
}

fn gain(picture: &mut RgbImage, factor: f64) {
    picture.iter_mut().for_each(|v| *v = (f64::from(*v) * factor).round().min(255.0) as u8);
}

pub fn through_jpeg(picture: &RgbImage, quality: u8) -> RgbImage {
    let mut bytes = Vec::new();
    picture.write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, quality)).unwrap();
    image::load_from_memory(&bytes).unwrap().to_rgb8()
}
