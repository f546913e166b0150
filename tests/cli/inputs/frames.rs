//! Frames under other names, in other containers, and what stands among them.

use super::Expected::{Good, Same, Told};
use super::cameras::{bending, calibrated};
use super::{case, hold};
use crate::program::Sandbox;
use image::{DynamicImage, ImageFormat};
use std::fs;
use std::path::PathBuf;

/// The frames in `lab`, in order.
fn frames(sandbox: &Sandbox) -> Vec<PathBuf> {
    let mut frames: Vec<PathBuf> =
        fs::read_dir(sandbox.join("lab/frames")).unwrap().map(|entry| entry.unwrap().path()).collect();
    frames.sort();
    frames
}

/// Every frame under another name, by its place and its number, and the pattern that finds them.
fn renamed(pattern: &'static str, name: impl Fn(usize, &str) -> String + 'static) -> impl Fn(&Sandbox) + 'static {
    move |sandbox| {
        for (k, path) in frames(sandbox).into_iter().enumerate() {
            let number = path.file_stem().unwrap().to_str().unwrap().to_owned();
            fs::rename(&path, path.with_file_name(name(k, &number))).unwrap();
        }
        let settings = sandbox.read("lab/experiment.toml").replace("frames/*.jpg", pattern);
        sandbox.write("lab/experiment.toml", &settings);
    }
}

/// Frames under another pattern.
fn named(pattern: &'static str) -> impl Fn(&Sandbox) + 'static {
    renamed(pattern, |_, number| format!("{number}.jpg"))
}

/// Every frame in another format.
fn converted(
    extension: &'static str,
    format: ImageFormat,
    change: impl Fn(DynamicImage) -> DynamicImage + 'static,
) -> impl Fn(&Sandbox) + 'static {
    move |sandbox| {
        for path in frames(sandbox) {
            let picture = change(image::open(&path).unwrap());
            picture.save_with_format(path.with_extension(extension), format).unwrap();
            fs::remove_file(path).unwrap();
        }
        let settings = sandbox.read("lab/experiment.toml").replace("*.jpg", &format!("*.{extension}"));
        sandbox.write("lab/experiment.toml", &settings);
    }
}

fn beside(name: &'static str, bytes: &'static [u8]) -> impl Fn(&Sandbox) + 'static {
    move |sandbox| fs::write(sandbox.join("lab/frames").join(name), bytes).unwrap()
}

/// The first frame with other bytes.
fn first(change: impl Fn(Vec<u8>) -> Vec<u8> + 'static) -> impl Fn(&Sandbox) + 'static {
    move |sandbox| {
        let path = &frames(sandbox)[0];
        fs::write(path, change(fs::read(path).unwrap())).unwrap();
    }
}

/// The rows of the log that belong to the frames.
fn rows_of_frames(sandbox: &Sandbox) -> String {
    let table = sandbox.read("lab/encoders.csv");
    let is_frames = |line: &&str| ["index", "0", "8", "17", "26", "34"].contains(&line.split(',').next().unwrap());
    table.lines().filter(is_frames).map(|line| format!("{line}\n")).collect()
}

/// The times of the frames by the log, s.
fn times(sandbox: &Sandbox) -> Vec<f64> {
    let time = |line: &str| line.split(',').nth(1).unwrap().parse().unwrap();
    rows_of_frames(sandbox).lines().skip(1).map(time).collect()
}

/// The index of each row as the rank of its frame.
fn by_rank(sandbox: &Sandbox) {
    let table = rows_of_frames(sandbox);
    let row = |(k, line): (usize, &str)| match k.checked_sub(1) {
        Some(rank) => format!("{rank},{}\n", line.split_once(',').unwrap().1),
        None => format!("{line}\n"),
    };
    sandbox.write("lab/encoders.csv", &table.lines().enumerate().map(row).collect::<String>());
}

#[test]
fn frames_are_found_and_read_whatever_they_are_called() {
    let sixteen_of_ten_bits = |picture: DynamicImage| {
        let mut picture = picture.to_luma16();
        picture.pixels_mut().for_each(|pixel| pixel.0[0] >>= 6);
        DynamicImage::ImageLuma16(picture)
    };
    hold(
        calibrated,
        vec![
            case("what macOS keeps beside files", beside("._00000.jpg", b"\0\x05\x16\x07\0\x02"), Same),
            case(
                "names of Windows",
                renamed("frames/*.jpg", |_, number| format!("image ({}).jpg", number.parse::<u64>().unwrap())),
                Same,
            ),
            case(
                "a date before the number",
                renamed("frames/*.jpg", |_, number| format!("2026-11-26_cam1_{number}.jpg")),
                Same,
            ),
            case(
                "a number that is not the last",
                renamed("frames/%05d_cam1.jpg", |_, number| format!("{number}_cam1.jpg")),
                Same,
            ),
            case(
                "a folder in a folder",
                |sandbox: &Sandbox| {
                    fs::create_dir(sandbox.join("lab/day 1")).unwrap();
                    fs::rename(sandbox.join("lab/frames"), sandbox.join("lab/day 1/take")).unwrap();
                    let settings = sandbox.read("lab/experiment.toml").replace("frames/*.jpg", "**/take/*.jpg");
                    sandbox.write("lab/experiment.toml", &settings);
                },
                Same,
            ),
            case("what a recorder leaves behind the picture", first(|bytes| [bytes, vec![0; 4096]].concat()), Same),
            case(
                "a channel of opacity",
                converted("png", ImageFormat::Png, |picture| DynamicImage::ImageRgba8(picture.to_rgba8())),
                Good("5 of 5 looked at were measured"),
            ),
            case(
                "grey",
                converted("png", ImageFormat::Png, |picture| DynamicImage::ImageLuma8(picture.to_luma8())),
                Good("5 of 5 looked at were measured"),
            ),
            case(
                "what Windows keeps beside files",
                |sandbox: &Sandbox| {
                    for (name, bytes) in [("Thumbs.db", b"\xd0\xcf\x11\xe0"), ("desktop.ini", b"[.S]")] {
                        fs::write(sandbox.join("lab/frames").join(name), bytes).unwrap();
                    }
                    let settings = sandbox.read("lab/experiment.toml").replace("frames/*.jpg", "frames/*");
                    sandbox.write("lab/experiment.toml", &settings);
                },
                Same,
            ),
            case("hidden files", beside(".00001.jpg", b"nothing"), Same),
            case(
                "numbers without zeros",
                renamed("frames/*.jpg", |_, number| format!("{}.jpg", number.parse::<u64>().unwrap())),
                Same,
            ),
            case("a picture with another ending", renamed("frames/*.png", |_, number| format!("{number}.png")), Same),
            case("a picture with no ending", renamed("frames/frame_*", |_, number| format!("frame_{number}")), Same),
            case(
                "a clip behind the picture",
                first(|bytes| [bytes, b"\xff\xda\0\0\0\x18ftypmp42\xff\xd8".to_vec()].concat()),
                Same,
            ),
            case("BMP", converted("bmp", ImageFormat::Bmp, |picture| picture), Good("5 of 5 looked at were measured")),
            case(
                "TIFF",
                converted("tif", ImageFormat::Tiff, |picture| picture),
                Good("5 of 5 looked at were measured"),
            ),
            case(
                "ten bits in sixteen",
                converted("png", ImageFormat::Png, sixteen_of_ten_bits),
                Good("5 of 5 looked at were measured"),
            ),
            case(
                "names that are times",
                |sandbox: &Sandbox| {
                    let times = times(sandbox);
                    // Seconds and nanoseconds, both without zeros before them.
                    let name = move |k: usize, _: &str| {
                        let nanoseconds = (1e9 * times[k]).round() as u64 - 205_000_000;
                        format!(
                            "frame_{}.{}.jpg",
                            1_738_133_057 + nanoseconds / 1_000_000_000,
                            nanoseconds % 1_000_000_000
                        )
                    };
                    renamed("frames/*.jpg", name)(sandbox);
                    by_rank(sandbox);
                },
                Good("5 of 5 frames and poses have a reading"),
            ),
            case(
                "names that are times, and a log by time",
                |sandbox: &Sandbox| {
                    let (table, times) = (rows_of_frames(sandbox), times(sandbox));
                    renamed("frames/*.jpg", move |k, _| format!("f_{:.6}.jpg", 1_738_133_057.0 + times[k]))(sandbox);
                    let later = |line: &str| {
                        let fields: Vec<&str> = line.splitn(3, ',').collect();
                        fields[1].parse::<f64>().map_or("t,q1_mm,q2_mm,q3_mm\n".to_owned(), |time_s| {
                            format!("{:.6},{}\n", 1_738_133_057.0 + time_s, fields[2])
                        })
                    };
                    sandbox.write("lab/encoders.csv", &table.lines().map(later).collect::<String>());
                    let settings =
                        sandbox.read("lab/experiment.toml").replacen("[[view]]", "[log]\ntime = \"t\"\n[[view]]", 1);
                    sandbox.write("lab/experiment.toml", &settings);
                },
                Good("5 of 5 frames and poses have a reading"),
            ),
            case(
                "a rotation mark",
                |sandbox: &Sandbox| {
                    for path in frames(sandbox) {
                        let jpeg = fs::read(&path).unwrap();
                        let mark =
                            b"\xff\xe1\0\x22Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
                        fs::write(&path, [&jpeg[..2], mark, &jpeg[2..]].concat()).unwrap();
                    }
                },
                Good("they are taken as they are stored"),
            ),
        ],
    );
}

#[test]
fn frames_that_cannot_be_read_are_named_with_the_reason() {
    let all = |bytes: &'static [u8]| {
        move |sandbox: &Sandbox| frames(sandbox).iter().for_each(|path| fs::write(path, bytes).unwrap())
    };
    let video: Vec<u8> = (0..600).map(|at| if at % 188 == 0 { 0x47 } else { 0 }).collect();
    hold(
        calibrated,
        vec![
            case(
                "a picture that is cut short",
                first(|bytes| bytes[..bytes.len() / 2].to_vec()),
                Told(&["1 of 5 frames looked at", "00000.jpg: the JPEG file is cut short"]),
            ),
            case(
                "pictures of a phone",
                all(b"\0\0\0\x18ftypheic\0\0\0\0"),
                Told(&["5 of 5 frames", "a HEIC picture, as iPhones take, expected PNG, JPEG, TIFF or BMP"]),
            ),
            case(
                "a folder in place of its pictures",
                named("frames"),
                Told(&["that is a folder: write frames = \\\"frames/*.jpg\\\""]),
            ),
            case(
                "letters of the ending",
                renamed("frames/*.jpg", |_, number| format!("{number}.JPG")),
                Told(&["5 files *.JPG"]),
            ),
            case(
                "pictures in motion of another kind",
                |sandbox: &Sandbox| {
                    fs::write(sandbox.join("lab/run.gif"), b"GIF89a\0\0\0\0").unwrap();
                    named("run.gif")(sandbox);
                },
                Told(&["run.gif: a GIF picture, expected pictures numbered in their names, a video"]),
            ),
            case(
                "two numbers in a name, of which the last repeats",
                renamed("frames/*.jpg", |_, number| format!("{number}_cam1.jpg")),
                Told(&["frame 1 is there twice", "write %05d (or %d) in its place"]),
            ),
            case(
                "names that are milliseconds, and a log that counts",
                renamed("frames/*.jpg", |k, _| format!("{}.jpg", 1_738_133_057_000 + 100 * k)),
                Told(&["no frame has a reading", "match the log by time"]),
            ),
            case(
                "pictures of half the size",
                converted("png", ImageFormat::Png, |picture| {
                    picture.resize(640, 360, image::imageops::FilterType::Triangle)
                }),
                Told(&["have 640×360 px", "the camera file says 1280×720"]),
            ),
            case(
                "one picture that repeats",
                |sandbox: &Sandbox| {
                    let all = frames(sandbox);
                    all.iter().for_each(|path| drop(fs::write(path, fs::read(&all[2]).unwrap())));
                },
                Told(&["camera_stuck", "the picture stands still"]),
            ),
            case("a page of a web server", all(b"<html>404</html>"), Told(&["no picture that is known, expected PNG"])),
            case("empty files", all(b""), Told(&["empty file, expected a picture"])),
            case(
                "numbers with a fraction",
                converted("tif", ImageFormat::Tiff, |picture| DynamicImage::ImageRgb32F(picture.to_rgb32f())),
                Told(&["whose white is not defined"]),
            ),
            case(
                "a video among pictures",
                move |sandbox: &Sandbox| fs::write(sandbox.join("lab/frames/00003.jpg"), &video).unwrap(),
                Told(&["00003.jpg: a video among 6 files"]),
            ),
            case(
                "two frames of one number",
                |sandbox: &Sandbox| {
                    fs::copy(sandbox.join("lab/frames/00000.jpg"), sandbox.join("lab/frames/0.jpg")).unwrap();
                },
                Told(&["frame 0 is there twice"]),
            ),
            case(
                "no frames",
                |sandbox: &Sandbox| frames(sandbox).iter().for_each(|path| fs::remove_file(path).unwrap()),
                Told(&["no file here matches"]),
            ),
        ],
    );
}

#[test]
fn a_straight_picture_that_is_not_there_is_looked_for_in_other_letters() {
    let other_letters = |sandbox: &Sandbox| {
        fs::rename(sandbox.join("lab/straight.jpg"), sandbox.join("lab/Straight.JPG")).unwrap();
    };
    hold(
        bending,
        vec![case(
            "the straight picture in other letters",
            other_letters,
            Told(&["straight.jpg is not there", "Straight.JPG is there"]),
        )],
    );
}
