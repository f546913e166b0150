//! A whole experiment of rendered frames, in the files that a real one has and those that tell the truth.

use super::render::render;
use super::scene::Scene;
use crate::camera::CameraFormat;
use crate::error::{Error, Result};
use crate::geometry::Configuration;
use crate::measure::{BodyPoint, Projection};
use crate::observation::Truth;
use crate::record::{truth_csv, write_atomically, write_model};
use crate::robot::{Model, Robot};
use image::codecs::jpeg::JpegEncoder;
use image::{ImageError, ImageFormat, RgbImage};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::io::Cursor;
use std::path::Path;

/// The format of rendered frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameFormat {
    /// Exact.
    Png,
    /// With this quality, 1 to 100.
    Jpeg(u8),
}

impl FrameFormat {
    fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Jpeg(_) => "jpg",
        }
    }

    fn encode(self, picture: &RgbImage) -> std::result::Result<Vec<u8>, ImageError> {
        let mut bytes = Cursor::new(Vec::new());
        match self {
            Self::Png => picture.write_to(&mut bytes, ImageFormat::Png)?,
            Self::Jpeg(quality) => picture.write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, quality))?,
        }
        Ok(bytes.into_inner())
    }
}

/// Renders one frame for each row of `truths` into a folder, beside everything that an experiment with one view needs:
/// the straight picture, camera.yaml, experiment.toml, and robot.toml if the robot is not the paper's. truth.csv, rig_truth.json and scene.toml say what is in them.
/// An encoders.csv that lies there already becomes the experiment's.
///
/// Frames are numbered by their index; the same seed gives the same files. `drawn` is called after each frame.
///
/// # Errors
/// A scene that cannot be drawn or has a blank paper, a file that cannot be written.
pub fn write_experiment(
    folder: &Path,
    scene: &Scene,
    truths: &[Truth],
    format: FrameFormat,
    seed: u64,
    drawn: &(dyn Fn() + Sync),
) -> Result<()> {
    scene.check()?;
    let experiment = experiment_toml(scene, format, folder.join("encoders.csv").exists())?;
    let write = |name: &str, content: &str| write_atomically(&folder.join(name), content.as_bytes());
    let draw = |name: &str, psi: Configuration, seed: u64| {
        let path = folder.join(format!("{name}.{}", format.extension()));
        let bytes = format
            .encode(&render(scene, psi, seed))
            .map_err(|e| Error::content(&path, format!("cannot encode the picture: {e}")))?;
        write_atomically(&path, &bytes)
    };

    write("camera.yaml", &scene.lens.to_file(CameraFormat::OpenCvYaml))?;
    write("scene.toml", &scene.to_toml()?)?;
    write("rig_truth.json", &rig_json(scene))?;
    write("truth.csv", &truth_csv(truths))?;
    draw("straight", Configuration::new(0.0, 0.0), seed)?;
    truths.par_iter().try_for_each(|truth| {
        let name = format!("frames/{:05}", truth.index);
        draw(&name, truth.configuration, seed.wrapping_add(1 + truth.index)).inspect(|()| drawn())
    })?;
    if has_own_robot(scene) {
        write_model(&folder.join("robot.toml"), &Model { robot: scene.robot.clone(), ..Model::default() })?;
    }
    write("experiment.toml", &experiment)
}

/// Whether the robot is another than the paper's, so that the experiment must name it.
fn has_own_robot(scene: &Scene) -> bool {
    scene.robot != Robot::default()
}

/// The indices of poses at which a part of the snake's middle line leaves the picture.
pub fn out_of_picture(scene: &Scene, truths: &[Truth]) -> Vec<u64> {
    let view = Projection { lens: &scene.lens, camera_from_base: scene.view.camera_from_base(), robot: &scene.robot };
    let places = |share: f64| BodyPoint { s_mm: share * scene.robot.length_mm, local: Vector3::zeros() };
    let is_out = |truth: &&Truth| {
        let curve = view.curve(truth.configuration);
        (0..=PLACES).any(|k| {
            let pixel = view.pixel(&curve, &places(f64::from(k) / f64::from(PLACES)));
            !scene.lens.contains(&pixel, view.diameter_px() / 2.0)
        })
    };
    truths.iter().filter(is_out).map(|truth| truth.index).collect()
}

/// Places along the snake that are looked at. Convention: closer to each other than the disks.
const PLACES: u32 = 20;

fn experiment_toml(scene: &Scene, format: FrameFormat, with_encoders: bool) -> Result<String> {
    let pitch = scene.grid_pitch_mm()?;
    let encoders = if with_encoders { "encoders = \"encoders.csv\"\n\n" } else { "" };
    let robot = if has_own_robot(scene) { "robot = \"robot.toml\"\n" } else { "" };
    let extension = format.extension();
    let standoff = scene.paper.standoff_mm;
    Ok(format!(
        "{robot}{encoders}[[view]]\nname = \"side\"\ncamera = \"camera.yaml\"\nframes = \"frames/*.{extension}\"\n\
         straight = \"straight.{extension}\"\ngrid_pitch_mm = {pitch:?}\nstandoff_mm = {standoff:?}\n"
    ))
}

/// Where the base is in the camera's frame, x_cam = R x_base + t, mm, and the lens.
fn rig_json(scene: &Scene) -> String {
    let camera_from_base = scene.view.camera_from_base();
    let rotation = camera_from_base.rotation.to_rotation_matrix();
    let rows: Vec<Vec<f64>> = rotation.matrix().row_iter().map(|row| row.iter().copied().collect()).collect();
    let (f, c) = (scene.lens.focal_px, scene.lens.centre_px);
    let json = serde_json::json!({
        "R": rows,
        "t": scene.view.base_mm,
        "K": [[f.x, 0.0, c.x], [0.0, f.y, c.y], [0.0, 0.0, 1.0]],
        "dist": scene.lens.distortion,
    });
    format!("{json:#}\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::read_frame;
    use crate::record::{EncoderLog, Experiment, read_truth};
    use crate::simulate::scene::Pattern;
    use nalgebra::{Point2, Vector2};
    use std::sync::atomic::{AtomicUsize, Ordering};

    fn small() -> Scene {
        let mut scene = Scene::default();
        (scene.lens.width, scene.lens.height) = (64, 48);
        (scene.lens.focal_px, scene.lens.centre_px) = (Vector2::new(220.0, 220.0), Point2::new(31.5, 23.5));
        scene.sensor.rays_per_pixel = 1;
        scene
    }

    #[test]
    fn an_experiment_reads_back_as_it_was_written() {
        let scene = small();
        let poses = [(3, 10.0, 0.0), (4, 20.0, 60.0), (11, 35.0, -120.0)];
        let truths = poses.map(|(index, t, d)| Truth { index, configuration: Configuration::from_degrees(t, d) });
        for format in [FrameFormat::Png, FrameFormat::Jpeg(60)] {
            let folder = tempfile::tempdir().unwrap();
            let folder = folder.path();
            std::fs::write(folder.join("encoders.csv"), "index,time_s,q1_mm,q2_mm,q3_mm\n").unwrap();
            let drawn = AtomicUsize::new(0);
            write_experiment(folder, &scene, &truths, format, 5, &|| {
                drawn.fetch_add(1, Ordering::Relaxed);
            })
            .unwrap();

            assert_eq!(drawn.into_inner(), 3);
            let experiment = Experiment::read(folder).unwrap();
            assert_eq!(experiment.encoders.as_ref().map(EncoderLog::path), Some(&*folder.join("encoders.csv")));
            let view = &experiment.views[0];
            assert_eq!(view.lens().unwrap(), scene.lens);
            let frames: Vec<u64> = view.open_frames(folder).unwrap().frames().unwrap().map(|f| f.index).collect();
            assert_eq!(frames, [3, 4, 11]);
            let back = read_truth(&folder.join("truth.csv")).unwrap();
            assert_eq!(back.rows.iter().map(|row| row.index).collect::<Vec<_>>(), [3, 4, 11]);
            assert_eq!(Scene::read(&folder.join("scene.toml")).unwrap(), scene);
            let frame = read_frame(&folder.join(format!("frames/00004.{}", format.extension()))).unwrap();
            let picture = render(&scene, truths[1].configuration, 5 + 1 + 4);
            let levels = picture.iter().enumerate().map(|(k, &v)| (frame.samples.level(k), f32::from(v)));
            let difference = levels.map(|(read, drawn)| (read - drawn).abs()).sum::<f32>();
            let allowed = if format == FrameFormat::Png { 0.0 } else { 10.0 };
            assert!(difference / frame.samples.len() as f32 <= allowed, "{difference}");
        }
    }

    #[test]
    fn a_blank_paper_is_no_rig() {
        let mut scene = small();
        scene.paper.pattern = Pattern::Blank;
        let folder = tempfile::tempdir().unwrap();
        let error = write_experiment(folder.path(), &scene, &[], FrameFormat::Png, 0, &|| ()).unwrap_err();
        assert!(error.to_string().contains("needs a grid"), "{error}");
    }
}
