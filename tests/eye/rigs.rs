//! Rigs as labs may have them: any camera, paper, snake and light within reason.

use nalgebra::Vector2;
use rand::{RngExt, SeedableRng, rngs::StdRng};
use snakeloop::simulate::scene::{Light, Lines, Paper, Pattern, Scene, Sensor, Surface, Viewpoint};

/// Uniform random numbers, the same for the same seed.
pub struct Random(StdRng);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(StdRng::seed_from_u64(seed))
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0.random_range(low..high)
    }

    pub fn chance(&mut self, probability: f64) -> bool {
        self.0.random_bool(probability)
    }
}

/// A clean, upright view through a lens of `focal_px`, in a picture `scale` times 1280×720.
fn sized(scale: f64, focal_px: f64) -> Scene {
    let mut scene = Scene::default();
    scene.lens.width = (1280.0 * scale) as u32;
    scene.lens.height = (720.0 * scale) as u32;
    scene.lens.focal_px = Vector2::repeat(scale * focal_px);
    scene.lens.centre_px = [f64::from(scene.lens.width) / 2.0 - 0.5, f64::from(scene.lens.height) / 2.0 - 0.5].into();
    scene
}

/// A rig that nobody has seen.
pub fn varied(random: &mut Random) -> Scene {
    let scale = if random.chance(0.7) { 0.5 } else { 1.0 };
    at_scale(scale, random)
}

/// The same in a picture `scale` times 1280×720.
pub fn at_scale(scale: f64, random: &mut Random) -> Scene {
    let distance_mm = random.between(120.0, 300.0);
    let mut scene = sized(scale, random.between(17.0, 21.0) * distance_mm);
    if random.chance(0.5) {
        scene.lens.distortion[0] = random.between(-0.25, 0.15);
        scene.lens.distortion[2] = random.between(-0.001, 0.001);
    }
    scene.view = Viewpoint {
        yaw_deg: random.between(-12.0, 12.0),
        pitch_deg: random.between(-12.0, 12.0),
        roll_deg: random.between(-8.0, 8.0),
        base_mm: [random.between(-2.0, 2.0), random.between(8.5, 11.5), distance_mm],
    };
    scene.paper = paper(random);
    let grey = random.between(25.0, 150.0);
    scene.surface = Surface {
        colour: [
            grey + random.between(-5.0, 25.0),
            grey + random.between(-5.0, 10.0),
            grey + random.between(-15.0, 10.0),
        ],
        highlight: random.between(0.0, 0.6),
        shininess: random.between(5.0, 60.0),
    };
    scene.light = light(random);
    scene.sensor =
        Sensor { rays_per_pixel: 4, blur_px: scale * random.between(0.5, 1.6), noise: random.between(1.0, 6.0) };
    scene
}

/// The modes of a snake that is no arc, degrees: curvature that varies by up to a quarter of the bend, an S, and a bow out of its plane.
pub fn shape(theta_deg: f64, random: &mut Random) -> [[f64; 2]; 3] {
    let varying = random.between(-0.25, 0.25) * theta_deg / 4.0;
    [[varying, random.between(-3.0, 3.0)], [random.between(-3.0, 3.0), random.between(-3.0, 3.0)], [0.0; 2]]
}

/// A lamp before the paper, with its gradient and the snake's shadow.
pub fn light(random: &mut Random) -> Light {
    Light {
        towards_lamp: [random.between(-1.0, 1.0), -1.0, random.between(-0.5, 1.0)],
        ambient: random.between(0.3, 0.7),
        gradient: [random.between(-0.3, 0.3), random.between(-0.3, 0.3)],
        vignetting: random.between(0.0, 0.3),
        shadow: random.between(0.0, 0.5),
        shadow_blur_mm: random.between(0.5, 3.0),
    }
}

fn paper(random: &mut Random) -> Paper {
    let grey = random.between(165.0, 245.0);
    let colour =
        [grey + random.between(-8.0, 8.0), grey + random.between(-8.0, 8.0), grey + random.between(-14.0, 6.0)];
    let ink: [f64; 3] = std::array::from_fn(|_| random.between(60.0, 200.0));
    let mixed = |share: f64| std::array::from_fn(|k| colour[k] * (1.0 - share) + ink[k].min(colour[k] - 10.0) * share);
    let pattern = if random.chance(0.2) {
        Pattern::Checkerboard { square_mm: if random.chance(0.5) { 2.0 } else { 5.0 }, colour: mixed(0.9) }
    } else {
        Pattern::GraphPaper {
            lines: vec![
                Lines { pitch_mm: 1.0, width_mm: random.between(0.05, 0.12), colour: mixed(random.between(0.3, 0.7)) },
                Lines { pitch_mm: 5.0, width_mm: random.between(0.08, 0.2), colour: mixed(0.75) },
                Lines { pitch_mm: 10.0, width_mm: random.between(0.1, 0.3), colour: mixed(1.0) },
            ],
        }
    };
    Paper {
        standoff_mm: random.between(15.0, 40.0),
        turn_deg: random.between(-10.0, 10.0),
        origin_mm: [random.between(0.0, 10.0), random.between(0.0, 10.0)],
        colour,
        pattern,
        stains: Vec::new(),
    }
}
