//! Cameras and streams: what may be set, and what came of it.

use serde::Serialize;
use std::fmt;
use std::path::Path;
use std::str::FromStr;

/// What to open.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CaptureTarget {
    /// A camera of this machine, by its number.
    Device(u32),
    /// A stream, by its address: `http://…`, `rtsp://…`.
    Stream(String),
}

impl CaptureTarget {
    /// A camera of this machine by its number or its device, such as `/dev/v4l/by-id/…`, whose number stays whichever plug it is in.
    ///
    /// # Errors
    /// A device that is not there, or is no camera; with the cameras that are.
    pub fn camera(name: &str) -> Result<Self, String> {
        if let Ok(number) = name.parse() {
            return Ok(Self::Device(number));
        }
        let device = Path::new(name).canonicalize().ok();
        let number = device
            .as_deref()
            .and_then(Path::file_name)
            .and_then(|name| name.to_string_lossy().strip_prefix("video").and_then(|number| number.parse().ok()));
        number.map(Self::Device).ok_or_else(|| format!("no camera{}", cameras_there()))
    }
}

/// The cameras that Linux has, with their names, for a message about one that cannot be opened; empty elsewhere.
pub fn cameras_there() -> String {
    if !cfg!(target_os = "linux") {
        return String::new();
    }
    let of = |pattern: &str| glob::glob(pattern).into_iter().flatten().flatten();
    let named = |device: std::path::PathBuf| {
        let short = device.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let name = std::fs::read_to_string(format!("/sys/class/video4linux/{short}/name")).unwrap_or_default();
        format!("{} ({})", device.display(), name.trim())
    };
    let there: Vec<String> =
        of("/dev/video*").map(named).chain(of("/dev/v4l/by-id/*").map(|path| path.display().to_string())).collect();
    match there.join(", ") {
        none if none.is_empty() => "; there is none (no /dev/video*)".to_owned(),
        some => format!("; there are {some}"),
    }
}

/// How to learn what a camera offers: OpenCV, through which cameras are read, cannot list it.
fn what_is_offered() -> String {
    let how = if cfg!(target_os = "linux") {
        "`v4l2-ctl --device /dev/videoN --list-formats-ext` lists the sizes, rates and four letters that it offers"
    } else {
        "ask for a size and a rate that its driver offers"
    };
    how.to_owned()
}

/// Four letters that say how a camera packs its pictures, such as MJPG or YUYV.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FourCc(pub [u8; 4]);

impl FromStr for FourCc {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let letters =
            <[u8; 4]>::try_from(text.as_bytes()).ok().filter(|letters| letters.iter().all(u8::is_ascii_graphic));
        letters.map(Self).ok_or("expected four letters such as MJPG or YUYV")
    }
}

impl fmt::Display for FourCc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&String::from_utf8_lossy(&self.0))
    }
}

impl Serialize for FourCc {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl CaptureSettings {
    /// What a person should know of the settings that a camera reports, beside those that it was asked for.
    pub fn remarks(&self, asked: &Self) -> Vec<String> {
        fn other<T: PartialEq + Copy>(
            name: &str,
            asked: Option<T>,
            found: Option<T>,
            words: impl Fn(T) -> String,
        ) -> Option<String> {
            let (asked, found) = (asked?, found?);
            (asked != found)
                .then(|| format!("the camera has {name} {}, and was asked for {}", words(found), words(asked)))
        }
        let automatic = (self.autofocus == Some(true)).then(|| {
            "the camera focuses by itself, which moves its lens and with it the camera file's numbers: set its focus by hand".to_owned()
        });
        let rate = other("frames a second:", self.asked_rate(asked), self.rate_fps, |rate| format!("{rate:.1}"));
        let size = other("a picture size of", asked.size, self.size, |(width, height)| format!("{width}×{height}"));
        let kind = other("pictures in", asked.fourcc, self.fourcc, |kind| kind.to_string());
        let refused: Vec<String> = [size, rate, kind].into_iter().flatten().collect();
        let offered = (!refused.is_empty()).then(what_is_offered);
        refused.into_iter().chain(offered).chain(automatic).collect()
    }

    /// The rate asked for, unless the one reported is the same to a percent.
    fn asked_rate(&self, asked: &Self) -> Option<f64> {
        asked.rate_fps.filter(|rate| self.rate_fps.is_some_and(|found| (found / rate - 1.0).abs() > 0.01))
    }
}

/// What a camera is asked for; what is `None` stays as it is.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct CaptureSettings {
    /// Width and height, px.
    pub size: Option<(u32, u32)>,
    /// Frames per second.
    pub rate_fps: Option<f64>,
    /// How pictures are packed on their way.
    pub fourcc: Option<FourCc>,
    /// Whether the camera focuses by itself, as far as it tells; it is not asked for.
    pub autofocus: Option<bool>,
    /// Exposure, in the camera's own unit; setting it switches automatic exposure off.
    pub exposure: Option<f64>,
    /// Focus, in the camera's own unit; setting it switches autofocus off.
    pub focus: Option<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_are_named_by_number_or_device_and_others_are_told() {
        assert_eq!(CaptureTarget::camera("2"), Ok(CaptureTarget::Device(2)));
        assert!(CaptureTarget::camera("/dev/v4l/by-id/no-such-camera").unwrap_err().starts_with("no camera"));
        assert_eq!("MJPG".parse(), Ok(FourCc(*b"MJPG")));
        assert!("MJPEG".parse::<FourCc>().is_err());
    }

    #[cfg(unix)]
    #[test]
    fn a_link_to_a_device_is_followed() {
        let folder = tempfile::tempdir().unwrap();
        let (device, link) = (folder.path().join("video7"), folder.path().join("usb-camera"));
        std::fs::write(&device, "").unwrap();
        std::os::unix::fs::symlink(&device, &link).unwrap();
        assert_eq!(CaptureTarget::camera(link.to_str().unwrap()), Ok(CaptureTarget::Device(7)));
    }

    #[test]
    fn what_a_camera_did_not_take_is_told() {
        let asked = CaptureSettings { size: Some((1280, 720)), rate_fps: Some(30.0), ..CaptureSettings::default() };
        let same = CaptureSettings { rate_fps: Some(30.003), ..asked };
        assert!(same.remarks(&asked).is_empty());
        let other = CaptureSettings { size: Some((640, 480)), rate_fps: Some(10.0), autofocus: Some(true), ..asked };
        let said = other.remarks(&asked).join("\n");
        for words in ["size of 640×480, and was asked for 1280×720", "10.0, and was asked for 30.0", "focus by hand"]
        {
            assert!(said.contains(words), "{said}");
        }
        assert_eq!(said.matches(&what_is_offered()).count(), 1);
    }
}
