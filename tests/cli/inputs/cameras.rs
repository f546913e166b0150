//! Camera files of other programs.

use super::Expected::{Good, Same, Told};
use super::{case, hold};
use crate::program::Sandbox;
use std::fs;
use std::path::Path;
use std::sync::OnceLock;

const FOCAL: &str = "4282.3399925231415";

/// The bundled experiment in `lab`, with a few of its frames, so that each case takes a second: of a bend in four directions.
pub fn bending() -> Sandbox {
    let sandbox = Sandbox::new();
    let bundled = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/bending");
    fs::create_dir_all(sandbox.join("lab/frames")).unwrap();
    for name in ["experiment.toml", "camera.yaml", "encoders.csv", "straight.jpg"] {
        fs::copy(bundled.join(name), sandbox.join("lab").join(name)).unwrap();
    }
    for index in [0, 8, 17, 26, 34] {
        let name = format!("frames/{index:05}.jpg");
        fs::copy(bundled.join(&name), sandbox.join("lab").join(&name)).unwrap();
    }
    sandbox
}

/// The same with its rig calibrated beforehand, for cases that do not ask how the straight picture is looked at: to calibrate it takes longer than
/// to measure its frames.
pub fn calibrated() -> Sandbox {
    static RIG: OnceLock<String> = OnceLock::new();
    let sandbox = bending();
    let calibrate =
        "calibrate rig --camera lab/camera.yaml --grid-pitch 1 --standoff 25 --straight lab/straight.jpg -o rig.toml";
    let rig = RIG.get_or_init(|| {
        sandbox.succeed(calibrate);
        sandbox.read("rig.toml")
    });
    sandbox.write("lab/rig.toml", rig);
    let settings = sandbox.read("lab/experiment.toml");
    let straight = "straight = \"straight.jpg\"\ngrid_pitch_mm = 1.0\nstandoff_mm = 25.0\n";
    assert!(settings.contains(straight), "{settings}");
    sandbox.write("lab/experiment.toml", &settings.replace(straight, "rig = \"rig.toml\"\n"));
    sandbox
}

/// A camera file with this text, in which `F` stands for the focal length.
fn file(text: &str) -> impl Fn(&Sandbox) + 'static {
    let text = text.replace('F', FOCAL);
    move |sandbox| sandbox.write("lab/camera.yaml", &text)
}

/// The view's camera, written into experiment.toml.
fn inline(camera: &str) -> impl Fn(&Sandbox) + 'static {
    let camera = camera.replace('F', FOCAL);
    move |sandbox| {
        let settings = sandbox.read("lab/experiment.toml").replace("\"camera.yaml\"", &camera);
        sandbox.write("lab/experiment.toml", &settings);
    }
}

const OPENCV: &str = "%YAML:1.0\n---\nimage_width: 1280\nimage_height: 720\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ F, 0., 639.5, 0., F, 359.5, 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: 14\n   dt: d\n   data: [ 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0. ]\n";
const ECHO: &str = "header:\n  stamp:\n    sec: 12\n    nanosec: 5\n  frame_id: camera\nheight: 720\nwidth: 1280\ndistortion_model: plumb_bob\nd:\n- 0.0\n- 0.0\n- 0.0\n- 0.0\n- 0.0\nk:\n- F\n- 0.0\n- 639.5\n- 0.0\n- F\n- 359.5\n- 0.0\n- 0.0\n- 1.0\nr:\n- 1.0\n- 0.0\n- 0.0\n- 0.0\n- 1.0\n- 0.0\n- 0.0\n- 0.0\n- 1.0\np:\n- F\n- 0.0\n- 639.5\n- 0.0\n- 0.0\n- F\n- 359.5\n- 0.0\n- 0.0\n- 0.0\n- 1.0\n- 0.0\nbinning_x: 0\nbinning_y: 0\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n  do_rectify: false\n---\nheader: {}\n";
const CALIB_IO: &str = r#"{"Calibration": {"cameras": [{"model": {"polymorphic_name": "libCalib::CameraModelOpenCV", "ptr_wrapper": {"valid": 1, "data": {
  "parameters": {"f": {"val": F, "state": 2}, "ar": {"val": 1.0}, "cx": {"val": 639.5}, "cy": {"val": 359.5}, "k1": {"val": 0}, "k2": {"val": 0},
  "k3": {"val": 0}, "k4": {"val": 0}, "k5": {"val": 0}, "k6": {"val": 0}, "p1": {"val": 0}, "p2": {"val": 0}, "s1": {"val": 0}, "s2": {"val": 0},
  "s3": {"val": 0}, "s4": {"val": 0}, "tauX": {"val": 0}, "tauY": {"val": 0}},
  "CameraModelCRT": {"CameraModelBase": {"imageSize": {"width": 1280, "height": 720}}}}}}}]}}"#;

const OPENCV_JSON: &str = r#"{"image_width": 1280, "image_height": 720,
  "camera_matrix": {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d", "data": [F, 0.0, 639.5, 0.0, F, 359.5, 0.0, 0.0, 1.0]},
  "distortion_coefficients": {"type_id": "opencv-matrix", "rows": 1, "cols": 5, "dt": "d", "data": [0, 0, 0, 0, 0]}}"#;
const OPENCV_XML: &str = "<?xml version=\"1.0\"?>\n<opencv_storage><image_width>1280</image_width><image_height>720</image_height>\n<camera_matrix type_id=\"opencv-matrix\"><rows>3</rows><cols>3</cols><dt>d</dt><data>F 0. 639.5 0. F 359.5 0. 0. 1.</data></camera_matrix>\n<distortion_coefficients type_id=\"opencv-matrix\"><rows>5</rows><cols>1</cols><dt>d</dt><data>0. 0. 0. 0. 0.</data></distortion_coefficients></opencv_storage>\n";
const VINS: &str = "%YAML:1.0\n---\nmodel_type: MODEL\ncamera_name: camera\nimage_width: 1280\nimage_height: 720\ndistortion_parameters:\n   k1: 0.0\n   k2: 0.0\n   p1: 0.0\n   p2: 0.0\nprojection_parameters:\n   fx: F\n   fy: F\n   cx: 639.5\n   cy: 359.5\n";

/// The camera file in other bytes.
fn encoded(bytes: fn(&str) -> Vec<u8>) -> impl Fn(&Sandbox) + 'static {
    move |sandbox| fs::write(sandbox.join("lab/camera.yaml"), bytes(&sandbox.read("lab/camera.yaml"))).unwrap()
}

/// A text as Windows' programs write it.
pub fn utf_16(text: &str) -> Vec<u8> {
    format!("\u{feff}{text}").encode_utf16().flat_map(u16::to_le_bytes).collect()
}

#[test]
fn cameras_are_read_whatever_program_wrote_them() {
    let with_window = ECHO.replace("height: 720\nwidth: 1280", "height: 1080\nwidth: 1920");
    let shifted = with_window.replace("- 639.5", "- 839.5").replace("- 359.5", "- 459.5").replace(
        "x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0",
        "x_offset: 200\n  y_offset: 100\n  height: 720\n  width: 1280",
    );
    let outside = shifted.replace("x_offset: 200", "x_offset: 800");
    hold(
        calibrated,
        vec![
            case("14 coefficients of OpenCV, the last six zero", file(OPENCV), Same),
            case(
                "12 coefficients",
                file(&OPENCV.replace("cols: 14", "cols: 12").replace(", 0., 0. ]\n", " ]\n")),
                Same,
            ),
            case(
                "lists of Python's yaml under K and D",
                file(
                    "K:\n- [F, 0.0, 639.5]\n- [0.0, F, 359.5]\n- [0.0, 0.0, 1.0]\nD: [0.0, 0.0, 0.0, 0.0, 0.0]\nwidth: 1280\nheight: 720\n",
                ),
                Same,
            ),
            case(
                "mtx and dist as JSON",
                file(
                    "{\"mtx\": [[F, 0, 639.5], [0, F, 359.5], [0, 0, 1]], \"dist\": [[0, 0, 0, 0, 0]], \"image_size\": [1280, 720]}",
                ),
                Same,
            ),
            case(
                "camera_matrix and dist_coeffs",
                file(
                    "camera_matrix: [[F, 0, 639.5], [0, F, 359.5], [0, 0, 1]]\ndist_coeffs: [[0.0], [0.0], [0.0], [0.0], [0.0]]\nresolution: [1280, 720]\n",
                ),
                Same,
            ),
            case(
                "image_Width, as OpenCV's sample writes it",
                file(
                    &OPENCV
                        .replace("image_width", "image_Width")
                        .replace("image_height", "image_Height")
                        .replace("camera_matrix", "Camera_Matrix")
                        .replace("distortion_coefficients", "Distortion_Coefficients"),
                ),
                Same,
            ),
            case("ros2 topic echo", file(ECHO), Same),
            case(
                "Kalibr",
                file(
                    "cam0:\n  cam_overlaps: []\n  camera_model: pinhole\n  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]\n  distortion_model: radtan\n  intrinsics: [F, F, 639.5, 359.5]\n  resolution: [1280, 720]\n  rostopic: /cam0/image_raw\n",
                ),
                Same,
            ),
            case(
                "anipose",
                file(
                    "[cam_0]\nname = \"side\"\nsize = [ 1280, 720,]\nmatrix = [ [ F, 0.0, 639.5,], [ 0.0, F, 359.5,], [ 0.0, 0.0, 1.0,],]\ndistortions = [ 0.0, 0.0, 0.0, 0.0, 0.0,]\nrotation = [ 0.0, 0.0, 0.0,]\ntranslation = [ 0.0, 0.0, 0.0,]\n\n[metadata]\nerror = 0.2\n",
                ),
                Same,
            ),
            case("calib.io", file(CALIB_IO), Same),
            case(
                "single numbers, as RealSense has them",
                file(
                    "{\"width\": 1280, \"height\": 720, \"fx\": F, \"fy\": F, \"ppx\": 639.5, \"ppy\": 359.5, \"coeffs\": [0,0,0,0,0], \"dist\": [0,0,0,0,0]}",
                ),
                Same,
            ),
            case(
                "single numbers of ORB-SLAM",
                file(
                    "%YAML:1.0\n---\nCamera.fx: F\nCamera.fy: F\nCamera.cx: 639.5\nCamera.cy: 359.5\nCamera.k1: 0.0\nCamera.k2: 0.0\nCamera.p1: 0.0\nCamera.p2: 0.0\nCamera.width: 1280\nCamera.height: 720\n",
                ),
                Same,
            ),
            case(
                "numbers in experiment.toml",
                inline("{ K = [[F, 0, 639.5], [0, F, 359.5], [0, 0, 1]], dist = [0, 0, 0, 0, 0], size = [1280, 720] }"),
                Same,
            ),
            case(
                "numbers without distortion",
                inline("{ K = [[F, 0.0, 639.5], [0.0, F, 359.5], [0.0, 0.0, 1.0]], size = [1280, 720] }"),
                Same,
            ),
            case("a window of the sensor", file(&shifted), Same),
            case("OpenCV's JSON", file(OPENCV_JSON), Same),
            case("OpenCV's XML", file(OPENCV_XML), Same),
            case("VINS", file(&VINS.replace("MODEL", "PINHOLE")), Same),
            case("ends of lines of Windows", file(&OPENCV.replace('\n', "\r\n")), Same),
            case("UTF-16, as PowerShell writes what a program prints", encoded(utf_16), Same),
            case("Latin-1 in a remark", encoded(|text| [b"# 20 \xb0C\n", text.as_bytes()].concat()), Same),
            case(
                "numbers in quotes",
                file(
                    "{\"K\": [[\"F\", 0, 639.5], [0, \"F\", 359.5], [0, 0, 1]], \"dist\": [0, 0, 0, 0], \"size\": [\"1280\", \"720\"]}",
                ),
                Same,
            ),
            case(
                "a window that is not within the sensor",
                file(&outside),
                Told(&["camera.yaml", "does not fit the sensor of 1920×1080 px"]),
            ),
            case(
                "a sensor binned by two",
                file(&ECHO.replace("binning_x: 0\nbinning_y: 0", "binning_x: 2\nbinning_y: 2")),
                Told(&["640×360"]),
            ),
            // The coefficients are those of the series of tan, so that this is the lens that the pictures were taken with.
            case(
                "a fisheye of Kalibr",
                file(
                    "cam0:\n  camera_model: pinhole\n  distortion_model: equidistant\n  distortion_coeffs: [0.3333333333, 0.1333333333, 0.0539682540, 0.0218694885]\n  intrinsics: [F, F, 639.5, 359.5]\n  resolution: [1280, 720]\n",
                ),
                Good("5 of 5 looked at were measured"),
            ),
            case(
                "a text that Python printed",
                file(
                    "size: [1280, 720]\ncamera_matrix: array([[F, 0., 639.5],\n   [0., F, 359.5],\n   [0., 0., 1.]])\n",
                ),
                Told(&["camera_matrix: holds the text", "expected numbers in a list"]),
            ),
            case(
                "coefficients as a text",
                file("K: [[F, 0, 639.5], [0, F, 359.5], [0, 0, 1]]\ndist: 0.1 0.0 0.0 0.0\nsize: [1280, 720]\n"),
                Told(&["dist: holds the text", "0.1 0.0 0.0 0.0"]),
            ),
            case(
                "coefficients that are null",
                file("{\"K\": [[F, 0, 639.5], [0, F, 359.5], [0, 0, 1]], \"dist\": null, \"size\": [1280, 720]}"),
                Told(&["dist: holds nothing"]),
            ),
            case(
                "decimal commas",
                file("image_width: 1280\nimage_height: 720\nfx: 4282,34\nfy: 4282,34\ncx: 639,5\ncy: 359,5\n"),
                Told(&["fx: holds the text", "decimal points"]),
            ),
            case("a mirror", file(&VINS.replace("MODEL", "MEI")), Told(&["model_type: mei, expected plumb_bob"])),
            case(
                "a mirror of Kalibr",
                file(
                    "cam0:\n  camera_model: omni\n  intrinsics: [1.1, F, F, 639.5, 359.5]\n  distortion_model: radtan\n  distortion_coeffs: [0, 0, 0, 0]\n  resolution: [1280, 720]\n",
                ),
                Told(&["camera_model: omni, expected plumb_bob"]),
            ),
            case(
                "a size that stands height first",
                file(
                    "{\"mtx\": [[F, 0, 639.5], [0, F, 359.5], [0, 0, 1]], \"dist\": [0, 0, 0, 0], \"imsize\": [720, 1280]}",
                ),
                Told(&["1280×720 px", "720×1280", "gave the height first"]),
            ),
            case("a tilted sensor", file(&OPENCV.replace("0. ]\n", "0.01 ]\n")), Told(&["a tilted sensor"])),
            case(
                "two cameras",
                file(
                    "cam0:\n  intrinsics: [F, F, 639.5, 359.5]\n  distortion_coeffs: [0, 0, 0, 0]\n  resolution: [1280, 720]\ncam1:\n  intrinsics: [F, F, 639.5, 359.5]\n  distortion_coeffs: [0, 0, 0, 0]\n  resolution: [1280, 720]\n",
                ),
                Told(&["2 cameras (cam0, cam1)", "give a file with the one of this view"]),
            ),
            case(
                "NumPy's archive",
                |sandbox| fs::write(sandbox.join("lab/camera.yaml"), b"PK\x03\x04\x14\0\0\0").unwrap(),
                Told(&["a zip archive", "NumPy's .npz", "camera = { K ="]),
            ),
            case(
                "seven coefficients",
                file("K: [[F, 0, 639.5], [0, F, 359.5], [0, 0, 1]]\nD: [0, 0, 0, 0, 0, 0, 0]\nsize: [1280, 720]\n"),
                Told(&["D: 7 numbers, expected 0, 4, 5, 8, 12 or 14"]),
            ),
            case(
                "no size",
                file("K: [[F, 0, 639.5], [0, F, 359.5], [0, 0, 1]]\nD: [0, 0, 0, 0, 0]\nrms: 0.2\n"),
                Told(&["no width and height of the pictures", "the keys found are K, D, rms"]),
            ),
            case(
                "another thing altogether",
                file("robot:\n  length: 26\n"),
                Told(&["no camera matrix", "robot.length"]),
            ),
            case(
                "a skew",
                file("K: [[F, 3, 639.5], [0, F, 359.5], [0, 0, 1]]\nD: [0, 0, 0, 0, 0]\nsize: [1280, 720]\n"),
                Told(&["K: ", "expected [fx, 0, cx"]),
            ),
            case(
                "numbers of a wrong shape in experiment.toml",
                inline("{ K = [[F, 0, 639.5], [0, F, 359.5], [0, 0, 1]], dist = [0, 0, 0], size = [1280, 720] }"),
                Told(&["dist: 3 numbers"]),
            ),
        ],
    );
}
