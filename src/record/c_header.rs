//! compensation.h: the table for a controller written in C, with a lookup that interpolates it.
//!
//! The lookup is the product of two cubics through the four nearest angles of the grid, δ going once round. Between the angles of the
//! default grid it is within 2 µm of the model; a grid on which it would be off by more than 0.2° of bend is refused.

use crate::error::{ArgumentError, GridError, Result};
use crate::geometry::Configuration;
use crate::robot::{Grid, Model, PerBackbone, TableRow};

/// The largest error of the lookup between two poses of a table, degrees of bend.
///
/// Convention: a fifth of the paper's σ of a measured angle.
const MOST_ERROR_DEG: f64 = 0.2;

/// The header, with the names of what is filled in between `@`.
const TEMPLATE: &str = include_str!("compensation.h.in");

/// The header as text. `rows` are the model's table over `grid`, δ running fastest; `source` says where the model comes from, and `do_not_use`
/// why the table must not be used, if that is so.
///
/// # Errors
/// [`ArgumentError::Grid`] for a grid with fewer than four angles either way, whose δ does not go once round in even steps, or that is too coarse.
pub fn compensation_c_header(
    model: &Model,
    grid: &Grid,
    rows: &[TableRow],
    source: &str,
    do_not_use: Option<&str>,
) -> Result<String> {
    let theta: Vec<f64> = grid.theta.values_deg().collect();
    let delta: Vec<f64> = grid.azimuths_deg().collect();
    let deltas = delta.len();
    let (&[theta_0, theta_1, _, .., theta_last], &[delta_0, delta_1, _, _, ..]) = (&theta[..], &delta[..]) else {
        return Err(ArgumentError::from(GridError::TooFewAngles { theta: theta.len(), delta: deltas }).into());
    };
    let step = delta_1 - delta_0;
    if (step * deltas as f64 - 360.0).abs() > 1e-6 {
        return Err(ArgumentError::from(GridError::NotRound { grid: grid.delta.to_string(), angles: deltas }).into());
    }
    let error_deg = between_poses_deg(model, (&theta, &delta), rows);
    if error_deg > MOST_ERROR_DEG {
        let effects = model.remembering_effects().join(", ");
        return Err(ArgumentError::from(match effects.is_empty() {
            true => GridError::TooCoarse { error_deg, most_deg: MOST_ERROR_DEG },
            false => GridError::Jumps { effects, error_deg },
        })
        .into());
    }
    let backbones = rows.first().map_or(0, |row| row.command_mm.len());
    let names: Vec<String> = (1..=backbones).map(|i| format!("q_command[{}]", i - 1)).collect();
    // What could end the comment early does not belong there.
    let in_comment = |text: &str| text.replace("*/", "").replace(['\n', '\r'], " ");
    let line = |(word, text): (&str, &str)| format!(" *\n * {word}: {}\n", in_comment(text));
    let conditions = model.conditions_of_single_poses();
    let holds_if = conditions.iter().map(|condition| ("HOLDS IF", &condition[..]));
    let marks: String = do_not_use.map(|why| ("DO NOT USE", why)).into_iter().chain(holds_if).map(line).collect();
    let define = do_not_use.map(|_| "#define SNAKELOOP_DO_NOT_USE 1\n".to_owned());
    let filled_in = [
        ("@VERSION@", env!("CARGO_PKG_VERSION").to_owned()),
        ("@SOURCE@", in_comment(source)),
        ("@MARK@", marks),
        ("@DEFINE@\n", define.unwrap_or_default()),
        ("@FIRST@", theta_0.to_string()),
        ("@LAST@", theta_last.to_string()),
        ("@THETAS@", theta.len().to_string()),
        ("@DELTAS@", deltas.to_string()),
        ("@THETA_0@", format!("{theta_0:?}")),
        ("@THETA_STEP@", format!("{:?}", theta_1 - theta_0)),
        ("@DELTA_0@", format!("{delta_0:?}")),
        ("@DELTA_STEP@", format!("{step:?}")),
        ("@Q@", names.join(", ")),
        ("@BACKBONES@", backbones.to_string()),
        ("@ZEROS@", vec!["0"; backbones].join(", ")),
        ("@VALUES@", values(rows, deltas)),
        ("@STATUSES@", statuses(rows, deltas)),
    ];
    Ok(filled_in.iter().fold(TEMPLATE.to_owned(), |text, (name, value)| text.replace(name, value)))
}

/// The largest error of the lookup in the middle between four poses, degrees of bend: what it commands bends the snake otherwise than the model
/// says by so much. A force that the backbones share bends nothing.
fn between_poses_deg(model: &Model, (theta, delta): (&[f64], &[f64]), rows: &[TableRow]) -> f64 {
    let (thetas, deltas) = (theta.len(), delta.len());
    let by_bend = model.robot.bend_by_displacement();
    let middles = (0..thetas - 1).flat_map(|i| (0..deltas).map(move |j| (i, j)));
    let error = |(i, j): (usize, usize)| {
        // As the lookup does it.
        let first = i.saturating_sub(1).min(thetas - 4);
        let (by_theta, by_delta) = (weights((i - first) as f64 + 0.5), weights(1.5));
        let mut q_mm = PerBackbone::repeat(model.robot.backbone_count(), 0.0);
        for (a, weight) in by_theta.iter().enumerate() {
            for (b, other) in by_delta.iter().enumerate() {
                let row = (first + a) * deltas + (j + b + deltas - 1) % deltas;
                q_mm += rows[row].command_mm * (weight * other);
            }
        }
        let step = delta[1] - delta[0];
        let pose = Configuration::from_degrees((theta[i] + theta[i + 1]) / 2.0, delta[j] + step / 2.0);
        // The line yields, so that only a part of q̃ bends: as much of its error as of itself.
        let wanted_mm = model.command(pose);
        let by_mm = pose.theta / by_bend.tr_mul(&wanted_mm).norm();
        (by_mm * by_bend.tr_mul(&(q_mm - wanted_mm)).norm()).to_degrees()
    };
    middles.map(error).fold(0.0, f64::max)
}

/// Weights of the cubic through values at 0, 1, 2 and 3, at x.
fn weights(x: f64) -> [f64; 4] {
    let [a, b, c, d] = [x, x - 1.0, x - 2.0, x - 3.0];
    [-b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0]
}

/// What the lookup returns at each pose.
fn statuses(rows: &[TableRow], deltas: usize) -> String {
    let status = |pose: &TableRow| match pose.sharing {
        Some(sharing) if !sharing.within => "2",
        _ if pose.extrapolated => "3",
        _ => "0",
    };
    let of_theta = |row: &[TableRow]| format!("    {{{}}},\n", row.iter().map(status).collect::<Vec<_>>().join(", "));
    rows.chunks(deltas).map(of_theta).collect()
}

/// The table's numbers, a row of braces for each θ, which has `deltas` poses.
fn values(rows: &[TableRow], deltas: usize) -> String {
    let cell = |pose: &TableRow| {
        let numbers: Vec<_> = pose.command_mm.iter().map(|q| format!("{q:.6}")).collect();
        format!("{{{}}}", numbers.join(", "))
    };
    let of_theta = |row: &[TableRow]| {
        let cells: Vec<String> = row.iter().map(cell).collect();
        format!("    {{{}}},\n", cells.join(",\n     "))
    };
    rows.chunks(deltas).map(of_theta).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Configuration;
    use crate::robot::{Model, compensation_table};
    use std::process::Command;

    fn model() -> Model {
        Model { eta: 1.221, lambda_mm: 0.1765, samples: Some(10), ..Model::default() }
    }

    /// What the compiled lookup says of each pose; `None` where it refuses.
    fn looked_up(header: &str, standard: &str, poses: &[(f64, f64)]) -> Vec<Option<[f64; 3]>> {
        const MAIN: &str = "#include \"compensation.h\"\n#include <stdio.h>\nint main(void) {\n  double t, d, q[3];\n  \
            while (scanf(\"%lf %lf\", &t, &d) == 2) {\n    if (snakeloop_command(t, d, q)) puts(\"outside\");\n    \
            else printf(\"%.9f %.9f %.9f\\n\", q[0], q[1], q[2]);\n  }\n  return 0;\n}\n";
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("compensation.h"), header).unwrap();
        std::fs::write(folder.path().join("main.c"), MAIN).unwrap();
        let text: String = poses.iter().map(|(theta, delta)| format!("{theta} {delta}\n")).collect();
        std::fs::write(folder.path().join("poses"), text).unwrap();
        let program = folder.path().join("lookup");
        let flags = [standard, "-pedantic", "-Wall", "-Wextra", "-Werror", "-o"];
        let built = Command::new("cc").args(flags).arg(&program).arg(folder.path().join("main.c")).arg("-lm").output();
        let built = built.unwrap();
        assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
        let poses = std::fs::File::open(folder.path().join("poses")).unwrap();
        let output = Command::new(program).stdin(poses).output().unwrap();
        let lines = String::from_utf8(output.stdout).unwrap();
        let numbers = |line: &str| {
            let numbers: Vec<f64> = line.split(' ').filter_map(|n| n.parse().ok()).collect();
            <[f64; 3]>::try_from(numbers).ok()
        };
        lines.lines().map(numbers).collect()
    }

    #[test]
    fn the_compiled_lookup_is_the_table_at_its_poses_and_the_model_between_them() {
        let grid = Grid::default();
        let rows = compensation_table(&model(), &grid).unwrap();
        let header = compensation_c_header(&model(), &grid, &rows, "a */ model", None).unwrap();
        let nodes: Vec<(f64, f64)> =
            rows.iter().map(|row| (row.configuration.theta_deg(), row.configuration.delta_deg())).collect();
        for (found, row) in looked_up(&header, "-std=c89", &nodes).iter().zip(&rows) {
            let found = found.unwrap();
            assert!((0..3).all(|k| (found[k] - row.command_mm[k]).abs() < 2e-6), "{found:?} {:?}", row.command_mm);
        }
        let between: Vec<(f64, f64)> =
            (0..400).map(|k| (f64::from(k) * 0.2255, f64::from(k * 37 % 1081) - 540.0)).collect();
        let mut worst = 0.0f64;
        for (found, &(theta, delta)) in looked_up(&header, "-std=c99", &between).iter().zip(&between) {
            let wanted = model().command(Configuration::from_degrees(theta, delta));
            worst = (0..3).map(|k| (found.unwrap()[k] - wanted[k]).abs()).fold(worst, f64::max);
        }
        assert!(worst < 2e-3, "{worst} mm");
        assert_eq!(looked_up(&header, "-std=c89", &[(91.0, 0.0), (-1.0, 0.0), (30.0, 1e18)]), [None, None, None]);
    }

    #[test]
    fn a_seam_that_is_named_twice_is_one_and_a_sector_is_refused() {
        let grid = |theta: &str, delta: &str| Grid { theta: theta.parse().unwrap(), delta: delta.parse().unwrap() };
        let header = |grid: &Grid| {
            compensation_c_header(&model(), grid, &compensation_table(&model(), grid).unwrap(), "built in", None)
        };
        let twice = header(&grid("0:60:20", "-180:180:30")).unwrap();
        assert!(twice.contains("#define SNAKELOOP_DELTAS 12"));
        let near = looked_up(&twice, "-std=c89", &[(40.0, 180.0), (40.0, -180.0), (40.0, 540.0)]);
        assert!(near.iter().all(|q| (q.unwrap()[0] - near[0].unwrap()[0]).abs() < 1e-9));
        assert!(matches!(header(&grid("0:60:20", "0:90:10")), Err(crate::Error::Argument(_))));
        assert!(matches!(header(&grid("0:60:60", "-180:180:30")), Err(crate::Error::Argument(_))));
        // Cubics through four azimuths are ten degrees off between them.
        let coarse = header(&grid("0:75:25", "-180:180:90")).unwrap_err().to_string();
        assert!(coarse.contains("of bend off the model"), "{coarse}");
    }
}
