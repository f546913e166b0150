//! Pictures of a scene, by casting rays.
//!
//! Nothing here knows how the eye looks for outlines: a pixel is the mean of the light along rays spread over its
//! square, each of which meets the snake's shapes, a wire or the grid target. The order of things is that of a camera:
//!
//! 1. rays through each pixel (one, where it shows paper of one colour), in linear light, times the lamp's gradient and the lens's vignetting;
//! 2. Gaussian blur;
//! 3. sRGB encoding, noise, rounding to 8 bits.

mod light;
mod printed_target;
mod shadow;
mod tiles;

use super::body::{Hit, Ray, Shape, body};
use super::scene::{Light, Scene, Wire};
use crate::geometry::Configuration;
use image::RgbImage;
use light::{Radiance, blurred, decoded, encoded};
use nalgebra::{Point2, Point3, Vector2, Vector3};
use printed_target::PrintedTarget;
use rand::{RngExt, SeedableRng, rngs::StdRng};
use rand_distr::StandardNormal;
use rayon::prelude::*;
use shadow::Shadow;
use tiles::Tiles;

/// The picture of a snake bent to ψ. The same seed gives the same noise.
///
/// A scene that does not pass [`Scene::check`] gives a picture without meaning, or a blank one.
pub fn render(scene: &Scene, psi: Configuration, seed: u64) -> RgbImage {
    let (width, height) = (scene.lens.width as usize, scene.lens.height as usize);
    let light: Vec<Radiance> = trace(scene, psi).into_iter().map(|pixel| pixel.light).collect();
    let light = blurred(light, width, height, scene.sensor.blur_px);

    let mut bytes = vec![0; 3 * width * height];
    bytes.par_chunks_mut((3 * width).max(1)).zip(light.par_chunks(width.max(1))).enumerate().for_each(
        |(row, (bytes, light))| {
            let mut noise = StdRng::seed_from_u64(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(row as u64));
            for (byte, value) in bytes.iter_mut().zip(light.iter().flatten()) {
                let mut level = encoded(*value);
                if scene.sensor.noise > 0.0 {
                    level += scene.sensor.noise * noise.sample::<f64, _>(StandardNormal);
                }
                *byte = level.round().clamp(0.0, 255.0) as u8;
            }
        },
    );
    RgbImage::from_raw(scene.lens.width, scene.lens.height, bytes).unwrap_or_default()
}

/// How much of each pixel's square the snake covers, 0 to 1, row by row; wires hide it. Blur and noise play no part.
pub fn coverage(scene: &Scene, psi: Configuration) -> Vec<f64> {
    trace(scene, psi).into_iter().map(|pixel| pixel.snake).collect()
}

/// The share of the snake in the picture that the scene's wires hide, 0 to 1.
pub fn hidden_fraction(scene: &Scene, psi: Configuration) -> f64 {
    let area = |scene: &Scene| coverage(scene, psi).iter().sum::<f64>();
    let whole = area(&Scene { wires: Vec::new(), ..scene.clone() });
    if whole > 0.0 { 1.0 - area(scene) / whole } else { 0.0 }
}

/// What the rays through one pixel found.
#[derive(Clone, Copy)]
struct Pixel {
    light: Radiance,
    snake: f64,
}

fn trace(scene: &Scene, psi: Configuration) -> Vec<Pixel> {
    let (width, height) = (scene.lens.width as usize, scene.lens.height as usize);
    if width == 0 || height == 0 {
        return Vec::new();
    }
    let base_from_camera = scene.view.camera_from_base().inverse();
    let stage = Stage::new(scene, psi);
    let samples = samples(scene.sensor.rays_per_pixel);
    let origin = base_from_camera * Point3::origin();
    // Directions through the corners between the pixels, row by row. Within a pixel the direction is taken as linear, which is exact without
    // distortion and better than 1e-5 px with any that a camera has.
    let corner = |row: usize, column: usize| {
        let ray = scene.lens.ray(&Point2::new(column as f64 - 0.5, row as f64 - 0.5));
        base_from_camera * (ray / ray.z)
    };
    let corners: Vec<Vec<Vector3<f64>>> =
        (0..=height).into_par_iter().map(|row| (0..=width).map(|column| corner(row, column)).collect()).collect();
    let mut pixels = vec![Pixel { light: Radiance::zeros(), snake: 0.0 }; width * height];
    pixels.par_chunks_mut(width).enumerate().for_each(|(row, pixels)| {
        let (above, below) = (&corners[row], &corners[row + 1]);
        for (column, pixel) in pixels.iter_mut().enumerate() {
            let (a, b, c, d) = (above[column], above[column + 1], below[column], below[column + 1]);
            let (middle, across, down) = ((a + b + c + d) / 4.0, (b + d - a - c) / 2.0, (c + d - a - b) / 2.0);
            let near = stage.tiles.near(column, row);
            if let Some(light) = stage.even_target(&origin, &middle, &[across, down], near) {
                pixel.light = light * falloff(scene, column, row);
                continue;
            }
            let shift = shift(column, row);
            for sample in &samples {
                let offset = (sample + shift).map(|v| if v < 1.0 { v - 0.5 } else { v - 1.5 });
                let direction = middle + offset.x * across + offset.y * down;
                let place = Point2::new(column as f64 + offset.x, row as f64 + offset.y);
                let found = stage.look(&origin, &direction, &place, near);
                pixel.light += found.light;
                pixel.snake += found.snake;
            }
            let share = 1.0 / samples.len() as f64;
            pixel.light *= share * falloff(scene, column, row);
            pixel.snake *= share;
        }
    });
    pixels
}

/// Places in the unit square: each of the n columns and rows of a fine grid holds one (van der Corput and Hammersley's
/// points), so that an edge nearly along a pixel's border moves the mean in n steps and not in √n.
fn samples(count: u32) -> Vec<Vector2<f64>> {
    let count = count.clamp(1, 4096).next_power_of_two();
    let bits = count.trailing_zeros();
    let reversed = |i: u32| if bits == 0 { 0 } else { i.reverse_bits() >> (32 - bits) };
    let place = |i: u32| (f64::from(i) + 0.5) / f64::from(count);
    (0..count).map(|i| Vector2::new(place(i), place(reversed(i)))).collect()
}

/// How far a pixel's samples are moved, round the unit square: otherwise a straight edge would meet the same pattern in
/// pixel after pixel, and the pattern's error would add up along it. A hash (Steele's SplitMix), not a random number, so
/// that it depends on the place alone.
fn shift(column: usize, row: usize) -> Vector2<f64> {
    let mut bits = (column as u64) << 32 | row as u64;
    bits = (bits ^ (bits >> 30)).wrapping_add(0x9e37_79b9_7f4a_7c15).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^= bits >> 31;
    Vector2::new((bits >> 32) as f64, (bits & 0xffff_ffff) as f64) / 4_294_967_296.0
}

/// The lamp's gradient and the lens's vignetting at a pixel.
fn falloff(scene: &Scene, column: usize, row: usize) -> f64 {
    let Light { gradient, vignetting, .. } = scene.light;
    let across = column as f64 / f64::from(scene.lens.width) - 0.5;
    let down = row as f64 / f64::from(scene.lens.height) - 0.5;
    let corner = 2.0 * (across * across + down * down);
    ((1.0 + gradient[0] * across + gradient[1] * down) * (1.0 - vignetting * corner)).max(0.0)
}

/// A scene made ready for rays.
struct Stage<'a> {
    scene: &'a Scene,
    shapes: Vec<Shape>,
    tiles: Tiles,
    shadow: Option<Shadow>,
    to_lamp: Vector3<f64>,
    skin: Radiance,
    wires: Vec<(&'a Wire, Radiance)>,
    target: PrintedTarget<'a>,
}

impl<'a> Stage<'a> {
    fn new(scene: &'a Scene, psi: Configuration) -> Self {
        let shapes = body(&scene.robot, &scene.profile(psi));
        let to_lamp = Vector3::from(scene.light.towards_lamp).normalize();
        Self {
            scene,
            tiles: Tiles::new(scene, &shapes),
            shadow: Shadow::new(scene, &shapes, &to_lamp),
            shapes,
            to_lamp,
            skin: decoded(&scene.surface.colour),
            wires: scene.wires.iter().map(|wire| (wire, decoded(&wire.colour))).collect(),
            target: PrintedTarget::new(&scene.paper),
        }
    }

    /// The light from one direction (of any length), which meets the picture at `place`; `near` are the shapes that may
    /// show there.
    fn look(&self, origin: &Point3<f64>, direction: &Vector3<f64>, place: &Point2<f64>, near: &[u16]) -> Pixel {
        if let Some((_, colour)) = self.wires.iter().find(|(wire, _)| wire.covers(place)) {
            return Pixel { light: *colour, snake: 0.0 };
        }
        if !near.is_empty() {
            let ray = Ray { origin: *origin, direction: direction.normalize() };
            let hits = near.iter().filter_map(|&k| self.shapes[usize::from(k)].meet(&ray));
            if let Some(hit) = hits.min_by(|a, b| a.distance.total_cmp(&b.distance)) {
                return Pixel { light: self.shade(&ray, &hit), snake: 1.0 };
            }
        }
        Pixel { light: self.target_seen(origin, direction), snake: 0.0 }
    }

    fn shade(&self, ray: &Ray, hit: &Hit) -> Radiance {
        let Scene { surface, light, .. } = self.scene;
        let lit = light.ambient + (1.0 - light.ambient) * hit.normal.dot(&self.to_lamp).max(0.0);
        let half_way = (self.to_lamp - ray.direction).normalize();
        let highlight = surface.highlight * hit.normal.dot(&half_way).max(0.0).powf(surface.shininess);
        lit * self.skin + Radiance::repeat(highlight)
    }

    fn target_seen(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Radiance {
        let Some(point) = self.on_target(origin, direction) else { return Radiance::zeros() };
        self.lit(&point) * self.target.colour_at(&point)
    }

    /// The light of a pixel that shows nothing but paper of one colour, for which one ray is enough: a shadow hardly changes within it.
    fn even_target(
        &self,
        origin: &Point3<f64>,
        middle: &Vector3<f64>,
        [across, down]: &[Vector3<f64>; 2],
        near: &[u16],
    ) -> Option<Radiance> {
        if !near.is_empty() || !self.wires.is_empty() {
            return None;
        }
        let point = self.on_target(origin, middle)?;
        let mut reach_mm = 0.0_f64;
        for corner in [across + down, across - down] {
            for side in [0.5, -0.5] {
                reach_mm = reach_mm.max((self.on_target(origin, &(middle + side * corner))? - point).norm());
            }
        }
        Some(self.lit(&point) * self.target.even_colour_at(&point, reach_mm)?)
    }

    /// Where a direction meets the plane of the target, (x_b, z_b), if it does so before the camera.
    fn on_target(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<Point2<f64>> {
        let distance = (self.scene.paper.standoff_mm - origin.y) / direction.y;
        (distance > 0.0 && distance.is_finite())
            .then(|| Point2::new(origin.x + distance * direction.x, origin.z + distance * direction.z))
    }

    /// The share of the lamp's light that reaches a place of the target.
    fn lit(&self, point: &Point2<f64>) -> f64 {
        1.0 - self.scene.light.shadow * self.shadow.as_ref().map_or(0.0, |shadow| shadow.at(point))
    }
}

impl Wire {
    fn covers(&self, place: &Point2<f64>) -> bool {
        let (from, to) = (Point2::from(self.from_px), Point2::from(self.to_px));
        let along = to - from;
        let share = ((place - from).dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        (place - (from + share * along)).norm() <= self.width_px / 2.0
    }
}

#[cfg(test)]
mod tests {
    use super::super::scene::{Colour, Lines, Pattern, Sensor, Stain, Viewpoint};
    use super::*;
    use crate::camera::Lens;
    use crate::statistics::moments::{mean, standard_deviation};
    use approx::assert_abs_diff_eq;

    const BLACK: Colour = [0.0; 3];
    const WHITE: Colour = [255.0; 3];

    /// A small picture from 200 mm, upright, sharp, with its principal point between pixels.
    fn small() -> Scene {
        let scene = Scene::default();
        Scene {
            lens: Lens {
                width: 160,
                height: 120,
                focal_px: Vector2::new(600.0, 620.0),
                centre_px: Point2::new(80.3, 90.6),
                distortion: [0.0; 12],
                fisheye: None,
            },
            view: Viewpoint { yaw_deg: 0.0, pitch_deg: 0.0, roll_deg: 0.0, base_mm: [0.0, 0.0, 200.0] },
            sensor: Sensor { rays_per_pixel: 256, blur_px: 0.0, noise: 0.0 },
            ..scene
        }
    }

    fn straight() -> Configuration {
        Configuration::new(0.0, 0.0)
    }

    /// One row of a picture, as the share of white light that is missing.
    fn darkness(scene: &Scene, row: usize) -> Vec<f64> {
        let width = scene.lens.width as usize;
        trace(scene, straight())[row * width..][..width].iter().map(|pixel| 1.0 - pixel.light.x).collect()
    }

    fn centroid(weights: &[f64]) -> f64 {
        let total: f64 = weights.iter().sum();
        weights.iter().enumerate().map(|(k, w)| k as f64 * w).sum::<f64>() / total
    }

    #[test]
    fn pixel_centres_are_at_integers() {
        let mut scene = small();
        for (x, y) in [(80.3, 90.6), (80.0, 90.0), (79.5, 89.5), (80.85, 90.15)] {
            scene.lens.centre_px = Point2::new(x, y);
            // The end disk's far face at the camera's height: its rim is seen edge on, at the principal point's row.
            scene.view.base_mm = [0.0, 26.0, 200.0];
            let covered = coverage(&scene, straight());
            let column: f64 = (0..92).map(|row| covered[row * 160 + 80]).sum();
            assert_abs_diff_eq!(91.5 - column, y, epsilon = 0.01);
            // The holder is symmetric about the principal point's column, and as wide as a cylinder of its radius is.
            scene.view.base_mm = [0.0, 0.0, 200.0];
            let row = &coverage(&scene, straight())[115 * 160..][..160];
            assert_abs_diff_eq!(centroid(row), x, epsilon = 0.01);
            let width = 2.0 * 600.0 * 2.1 / (200.0f64.powi(2) - 2.1f64.powi(2)).sqrt();
            assert_abs_diff_eq!(row.iter().sum::<f64>(), width, epsilon = 0.01);
        }
    }

    #[test]
    fn lines_on_the_paper_are_where_the_lens_projects_them() {
        let mut scene = small();
        scene.view = Viewpoint { yaw_deg: 4.0, pitch_deg: -7.0, roll_deg: 3.0, base_mm: [1.0, 2.0, 150.0] };
        scene.lens.distortion[..5].copy_from_slice(&[-0.3, 0.2, 0.003, -0.002, 0.1]);
        scene.paper.turn_deg = 5.0;
        scene.paper.origin_mm = [12.0, 3.0];
        scene.paper.colour = WHITE;
        let lines = vec![Lines { pitch_mm: 1000.0, width_mm: 1.5, colour: BLACK }];
        scene.paper.pattern = Pattern::GraphPaper { lines };
        let camera_from_base = scene.view.camera_from_base();
        let (sin, cos) = 5.0f64.to_radians().sin_cos();
        // The line along the paper's own z through the origin.
        let on_line =
            |z: f64| scene.lens.project(&(camera_from_base * Point3::new(12.0 - z * sin, 25.0, 3.0 + z * cos)));
        for row in [5, 20, 50] {
            let (mut low, mut high) = (-30.0, 60.0);
            for _ in 0..60 {
                let middle = (low + high) / 2.0;
                if on_line(middle).y > f64::from(row) { low = middle } else { high = middle }
            }
            let dark = darkness(&scene, row as usize);
            let expected = on_line(low).x;
            // The two edges, from how much is dark on either side of the line's middle pixel.
            let middle = expected.round() as usize;
            let left = middle as f64 + 0.5 - dark[middle - 6..=middle].iter().sum::<f64>();
            let right = middle as f64 - 0.5 + dark[middle..=middle + 6].iter().sum::<f64>();
            assert_abs_diff_eq!((left + right) / 2.0, expected, epsilon = 0.01);
        }
    }

    #[test]
    fn the_base_frame_is_the_design_s() {
        let mut scene = small();
        scene.sensor.rays_per_pixel = 16;
        // Where the picture above the base holds snake: mean column, mean row, and the widest row.
        let seen = |delta_deg: f64| {
            let covered = coverage(&scene, Configuration::from_degrees(70.0, delta_deg));
            let rows: Vec<f64> = covered.chunks(160).take(80).map(|row| row.iter().sum()).collect();
            let columns: Vec<f64> = (0..160).map(|x| (0..80).map(|y| covered[y * 160 + x]).sum()).collect();
            (centroid(&columns), centroid(&rows), rows.iter().copied().fold(0.0, f64::max))
        };
        let (right, left, away, towards) = (seen(0.0), seen(180.0), seen(90.0), seen(-90.0));
        assert!(right.0 > 90.0 && left.0 < 70.0, "x_b points to the right: {right:?} {left:?}");
        assert!(away.2 < towards.2, "y_b points away: {away:?} {towards:?}");
        let (_, straight_row) =
            (0, coverage(&scene, straight()).chunks(160).position(|row| row.iter().sum::<f64>() > 1.0));
        assert!(straight_row.unwrap() < 15, "z_b points up");
    }

    #[test]
    fn tiles_leave_no_shape_out() {
        let mut scene = small();
        scene.view = Viewpoint { yaw_deg: 25.0, pitch_deg: 15.0, roll_deg: 8.0, base_mm: [3.0, -1.0, 90.0] };
        scene.lens.distortion[..5].copy_from_slice(&[-0.3, 0.1, 0.002, -0.002, 0.0]);
        scene.sensor.rays_per_pixel = 1;
        for (theta_deg, delta_deg) in [(0.0, 0.0), (50.0, 30.0), (90.0, -100.0), (120.0, 170.0)] {
            let psi = Configuration::from_degrees(theta_deg, delta_deg);
            let covered = coverage(&scene, psi);
            let shapes = body(&scene.robot, &scene.profile(psi));
            let base_from_camera = scene.view.camera_from_base().inverse();
            for (k, &found) in covered.iter().enumerate() {
                let sample = (Vector2::repeat(0.5) + shift(k % 160, k / 160)).map(f64::fract);
                let pixel = Point2::new((k % 160) as f64 - 0.5, (k / 160) as f64 - 0.5) + sample;
                let direction = base_from_camera * scene.lens.ray(&pixel);
                let ray = Ray { origin: base_from_camera * Point3::origin(), direction };
                let expected = shapes.iter().any(|shape| shape.meet(&ray).is_some());
                assert_eq!(found, f64::from(u8::from(expected)), "θ {theta_deg}, δ {delta_deg}, {pixel}");
            }
        }
    }

    #[test]
    fn each_sample_has_its_own_column_and_row() {
        for count in [1, 2, 16, 64] {
            for axis in [0, 1] {
                let mut places: Vec<f64> = samples(count).iter().map(|s| s[axis] * f64::from(count) - 0.5).collect();
                places.sort_by(f64::total_cmp);
                assert!(places.iter().enumerate().all(|(k, &place)| place == k as f64), "{places:?}");
            }
        }
    }

    #[test]
    fn noise_has_its_sigma_and_its_seed() {
        let mut scene = small();
        scene.paper.pattern = Pattern::Blank;
        scene.paper.colour = [120.0; 3];
        scene.sensor.rays_per_pixel = 1;
        let clean = render(&scene, straight(), 0);
        scene.sensor.noise = 5.0;
        let noisy = render(&scene, straight(), 7);
        assert_eq!(noisy, render(&scene, straight(), 7));
        assert_ne!(noisy, render(&scene, straight(), 8));
        let error: Vec<f64> = noisy.iter().zip(clean.iter()).map(|(&a, &b)| f64::from(a) - f64::from(b)).collect();
        let (mean, sigma) = (mean(error.iter().copied()), standard_deviation(&error));
        assert!(mean.abs() < 0.1, "{mean}");
        // Rounding adds 1/12 of a level squared.
        assert_abs_diff_eq!(sigma, (25.0f64 + 1.0 / 12.0).sqrt(), epsilon = 0.1);
    }

    #[test]
    fn paper_shows_its_own_colour() {
        let mut scene = small();
        scene.paper.pattern = Pattern::Blank;
        scene.paper.colour = [200.0, 150.0, 90.0];
        assert_eq!(render(&scene, straight(), 0).get_pixel(10, 10).0, [200, 150, 90]);
        scene.paper.pattern = Pattern::Checkerboard { square_mm: 5.0, colour: [20.0, 30.0, 40.0] };
        let picture = render(&scene, straight(), 0);
        let dark = picture.pixels().filter(|p| p.0 == [20, 30, 40]).count();
        let bare = picture.pixels().filter(|p| p.0 == [200, 150, 90]).count();
        assert!(dark > 4000 && bare > 4000 && dark.abs_diff(bare) < 1500, "{dark} {bare}");
    }

    #[test]
    fn light_stains_and_shadow_change_the_paper_where_they_should() {
        let mut scene = small();
        scene.sensor.rays_per_pixel = 4;
        scene.paper.pattern = Pattern::Blank;
        let clean = render(&scene, straight(), 0);
        let level = |picture: &RgbImage, x: f64, z: f64| {
            let pixel = scene.lens.project(&(scene.view.camera_from_base() * Point3::new(x, 25.0, z)));
            i32::from(picture.get_pixel(pixel.x.round() as u32, pixel.y.round() as u32).0[0])
        };

        let mut stained = scene.clone();
        stained.paper.stains.push(Stain { centre_mm: [-15.0, 15.0], radius_mm: 3.0, colour: [128.0; 3] });
        let picture = render(&stained, straight(), 0);
        assert!(level(&picture, -15.0, 15.0) < level(&clean, -15.0, 15.0) - 50);
        assert_eq!(level(&picture, -15.0, 19.0), level(&clean, -15.0, 19.0));

        let mut shaded = scene.clone();
        shaded.light.towards_lamp = [1.0, -2.0, 0.0];
        (shaded.light.shadow, shaded.light.shadow_blur_mm) = (0.5, 0.3);
        let picture = render(&shaded, straight(), 0);
        // The lamp stands 1 right for 2 before: the axis' shadow falls 12.5 mm to the left of the snake.
        assert!(level(&picture, -12.5, -5.0) < level(&clean, -12.5, -5.0) - 30);
        assert_eq!(level(&picture, -18.0, -5.0), level(&clean, -18.0, -5.0));

        let mut uneven = scene.clone();
        uneven.light.gradient = [0.5, 0.0];
        let picture = render(&uneven, straight(), 0);
        assert!(level(&picture, 20.0, 0.0) > level(&picture, -20.0, 0.0) + 20);
    }

    #[test]
    fn wires_hide_what_they_cover() {
        let mut scene = small();
        scene.sensor.rays_per_pixel = 4;
        assert_eq!(hidden_fraction(&scene, straight()), 0.0);
        scene.wires = vec![Wire { from_px: [0.0, 40.0], to_px: [160.0, 40.0], width_px: 12.0, colour: BLACK }];
        let hidden = hidden_fraction(&scene, straight());
        assert!((0.02..0.2).contains(&hidden), "{hidden}");
        assert_eq!(render(&scene, straight(), 0).get_pixel(80, 40).0, [0, 0, 0]);
        scene.wires[0].width_px = 1000.0;
        assert_eq!(hidden_fraction(&scene, straight()), 1.0);
    }

    #[test]
    fn a_scene_without_meaning_gives_some_picture() {
        let mut scene = small();
        scene.sensor.rays_per_pixel = 3;
        scene.view.base_mm = [f64::NAN; 3];
        render(&scene, straight(), 0);
        scene = small();
        scene.sensor.rays_per_pixel = 0;
        scene.robot.length_mm = 0.0;
        scene.light.shadow = 1.0;
        scene.light.towards_lamp = [0.0; 3];
        render(&scene, Configuration::from_degrees(f64::NAN, 10.0), 0);
        scene.lens.width = 0;
        assert_eq!(render(&scene, straight(), 0).dimensions(), (0, 120));
        // The camera inside the snake, and looking along the target.
        scene = small();
        scene.sensor.rays_per_pixel = 1;
        scene.view = Viewpoint { yaw_deg: 90.0, pitch_deg: 0.0, roll_deg: 0.0, base_mm: [0.0, 0.0, 0.0] };
        render(&scene, Configuration::from_degrees(170.0, 10.0), 0);
    }
}
