//! The wiring check's finding in words: what is wrong, and how to write the correction down.

use super::evidence::{Subject, ViewOffset};
use super::reason::{Code, Level, Reason, Suggestion};
use super::scale::{Unit, unit};
use super::wiring::{Mistake, WiringCheck, largest_misalignment};
use crate::geometry::wrap_angle;
use crate::observation::Wiring;
use std::f64::consts::{PI, TAU};

/// A turn of a view is told by its usual cause where it agrees with that to so much, rad. Convention: 3°, as well as a camera is
/// turned by hand.
const SAME_TURN: f64 = 3.0 * PI / 180.0;

/// The reason that a finding makes, where there is one.
pub(super) fn wiring(subject: &Subject, check: &WiringCheck) -> Option<Reason> {
    let unit = unit(subject.model, check.gain, check.sd_gain);
    let misfits = format!(
        "the bends then agree with the readings to {:.1} times the noise, and to {:.0} times as it is now",
        check.misfit_corrected, check.misfit
    );
    match &check.mistake {
        Some(Mistake::Clock { age_s }) => Some(clock(subject, *age_s, &misfits)),
        Some(Mistake::View { view, turn, mirrored }) => azimuth(subject, view, *turn, *mirrored, &misfits),
        Some(Mistake::Log(wiring)) => Some(log(subject, wiring, unit, &misfits)),
        None => unit.map(|unit| log(subject, &Wiring::straight(subject.wiring.columns.len()), Some(unit), "")),
    }
}

/// Columns, signs, rows and unit.
fn log(subject: &Subject, found: &Wiring, unit: Option<Unit>, misfits: &str) -> Reason {
    let mut said = Vec::new();
    let backbones = found.columns.len();
    if found.columns.iter().enumerate().any(|(i, column)| *column != i + 1) {
        let places = found.columns.iter().enumerate().filter(|(i, column)| **column != i + 1);
        let moved: Vec<String> =
            places.map(|(i, column)| format!("backbone {} stands in column q{column}", i + 1)).collect();
        said.push(moved.join(", "));
    }
    let flipped: Vec<String> =
        (0..backbones).filter(|&i| found.signs[i] < 0).map(|i| format!("backbone {}", i + 1)).collect();
    if flipped.len() == backbones {
        said.push("all encoders count the other way".to_owned());
    } else if !flipped.is_empty() {
        said.push(format!("the encoder of {} counts the other way", flipped.join(" and ")));
    }
    if found.index_shift != 0 {
        let (rows, side) = (found.index_shift.abs(), if found.index_shift > 0 { "after" } else { "before" });
        said.push(format!("a frame's reading stands {rows} row{} {side} its own", if rows == 1 { "" } else { "s" }));
    }
    said.extend(unit.map(readings_are));
    let text = match misfits {
        "" => format!("encoder log: {}", said.join("; ")),
        _ => format!("encoder log: {}; {misfits}", said.join("; ")),
    };
    let scale = unit.map_or(1.0, |unit| unit.mm);
    let wiring = subject.wiring.then(&Wiring { scale, ..found.clone() });
    let header = header(&wiring).map_or(String::new(), |header| format!(", or call the log's columns {header}"));
    let own = unit.and_then(|unit| unit.of_the_machine);
    let own = own.map_or(String::new(), |(what, scale)| format!("; if the log is {what}, scale is {scale}"));
    let remedy = format!("if the robot is so wired, write into experiment.toml: {}{header}{own}", in_toml(&wiring));
    let suggestion = Suggestion { wiring, clock_offset_s: None, view: None, delta_offset_deg: None, mirrored: false };
    Reason { suggestion: Some(suggestion), ..Reason::new(Code::Wiring, Level::DoNotUse, text, remedy) }
}

/// The unit of the readings, with all that it may be.
fn readings_are(unit: Unit) -> String {
    let Unit { name, of_the_machine, eta, mm_at_nominal_eta, eta_as_it_is, .. } = unit;
    let named = name.map(|name| format!("{name} (η is then {eta:.2})"));
    let own = of_the_machine.map(|(what, _)| what.to_owned());
    let all: Vec<String> = named.into_iter().chain(own).collect();
    let what = if all.is_empty() { "in another unit than mm".to_owned() } else { all.join(", or ") };
    format!(
        "the readings are {what}: taken for mm they make η {eta_as_it_is:.2}; at η = 1 one unit is {mm_at_nominal_eta} mm"
    )
}

/// The table of an experiment.toml.
fn in_toml(wiring: &Wiring) -> String {
    format!(
        "[wiring] with columns = {:?}, signs = {:?}, scale = {:?}, index_shift = {}",
        wiring.columns, wiring.signs, wiring.scale, wiring.index_shift
    )
}

/// The header that says the same, where only the order of columns is wrong.
fn header(wiring: &Wiring) -> Option<String> {
    let straight = Wiring::straight(wiring.columns.len());
    let only_order = Wiring { columns: straight.columns.clone(), ..wiring.clone() } == straight;
    only_order.then(|| {
        let backbone_in = |column: usize| wiring.columns.iter().position(|c| *c == column).map_or(0, |i| i + 1);
        let names: Vec<String> =
            (1..=wiring.columns.len()).map(|column| format!("q{}_mm", backbone_in(column))).collect();
        format!("index,time_s,{}", names.join(","))
    })
}

/// The clock.
fn clock(subject: &Subject, age_s: f64, misfits: &str) -> Reason {
    let side = if age_s > 0.0 { "older" } else { "newer" };
    let text = format!("the readings are about {:.2} s {side} than their frames; {misfits}", age_s.abs());
    let remedy = format!(
        "stamp readings and frames by one clock; for `live`, --encoder-offset {:.2}; a camera that is late by its nature is the \
         effect camera_latency, which `snakeloop discover` fits",
        -age_s
    );
    let suggestion = Suggestion {
        wiring: subject.wiring.clone(),
        clock_offset_s: Some(-age_s),
        view: None,
        delta_offset_deg: None,
        mirrored: false,
    };
    Reason { suggestion: Some(suggestion), ..Reason::new(Code::Clock, Level::DoNotUse, text, remedy) }
}

/// Columns that hold the backbones so many places on. A camera that looks from there shows the same, but nothing puts a camera at that very
/// angle.
fn moved_on(subject: &Subject, places: usize, offset_deg: f64, misfits: &str) -> Reason {
    let backbones = subject.wiring.columns.len();
    let columns = (0..backbones).map(|i| (i + backbones - places) % backbones + 1).collect();
    let reason = log(subject, &Wiring { columns, ..Wiring::straight(backbones) }, None, misfits);
    let remedy = format!(
        "{}; if the camera was moved round the robot instead: delta_offset_deg = {offset_deg:.1}",
        reason.remedy
    );
    Reason { remedy, ..reason }
}

/// The azimuth of a view. A small turn is physics (`plane_misalignment`) and none of this check's business.
fn azimuth(subject: &Subject, view: &Option<String>, turn: f64, mirrored: bool, misfits: &str) -> Option<Reason> {
    let known = subject.views.iter().find(|known| Some(&known.name) == view.as_ref() || subject.views.len() == 1);
    let offset_deg = known.map(|ViewOffset { delta_offset_deg, .. }| *delta_offset_deg);
    let named = view.as_ref().map_or("the view".to_owned(), |name| format!("view {name:?}"));
    let offset = offset_deg.unwrap_or(0.0).to_radians();
    let is = |expected: f64| wrap_angle(turn - expected).abs() < SAME_TURN;
    let backbones = subject.wiring.columns.len();
    let places = (1..backbones).find(|places| is(*places as f64 * TAU / backbones as f64));
    if let Some(places) = places.filter(|_| !mirrored && subject.views.len() < 2) {
        return Some(moved_on(subject, places, wrap_angle(offset + turn).to_degrees(), misfits));
    }
    let pictures_mirrored = mirrored && is(PI + 2.0 * offset);
    let right = wrap_angle(offset + turn).to_degrees();
    let (what, remedy) = if pictures_mirrored {
        let remedy = "switch off mirroring in the camera's driver, or flip the pictures from left to right, the straight one too";
        (format!("the pictures of {named} are mirrored"), remedy.to_owned())
    } else if mirrored {
        let remedy = "number the backbones the other way round (exchange two columns of the log under [wiring] of experiment.toml), \
                      or flip mirrored pictures";
        (format!("in {named} azimuths run the other way round"), remedy.to_owned())
    } else {
        let cause = match offset_deg {
            Some(given) if given != 0.0 && is(-2.0 * offset) => "it has the wrong sign",
            Some(given) if given != 0.0 && is(offset.to_degrees() - offset) => "it is in radians",
            Some(given) if given != 0.0 && is(-offset) => "there should be none",
            _ if turn.abs() <= largest_misalignment() => return None,
            _ => "the camera looks from elsewhere",
        };
        let turn_deg = format!("{:.1}°", turn.to_degrees()).replace('-', "−");
        let place =
            known.map_or("add to delta_offset_deg of the view", |_| "write under its [[view]]: delta_offset_deg =");
        (format!("the azimuth of {named} is turned by {turn_deg}: {cause}"), format!("{place} {right:.1}"))
    };
    let suggestion = Suggestion {
        wiring: subject.wiring.clone(),
        clock_offset_s: None,
        view: view.clone(),
        delta_offset_deg: (!mirrored).then_some(right),
        mirrored: pictures_mirrored,
    };
    let text = format!("{what}; {misfits}");
    Some(Reason { suggestion: Some(suggestion), ..Reason::new(Code::Wiring, Level::DoNotUse, text, remedy) })
}
