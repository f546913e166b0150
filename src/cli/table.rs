//! `table`: the compensation table on any grid.

use super::console::Console;
use super::inputs::{WorthArgs, force_limits, tell_of_learning, tell_of_missed_poses, with_effects};
use crate::Result;
use crate::cli::failure::Failure;
use crate::record::{OutputFolder, Worth, stale_mark, write_compensation_rows};
use crate::robot::{Effect, ForceLimits, Grid, GridAxis, Model, TableRow, compensation_table};
use serde::Serialize;
use std::path::PathBuf;

/// Tabulate what to command for every pose of a grid: writes OUT/compensation.csv and OUT/compensation.json
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  snakeloop table --model out/model.toml --theta-deg 0:90:2 --delta-deg=-170:180:10 -o out"
)]
pub struct Args {
    /// The model (model.toml); by default the paper's, with Table I
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// An effect in addition to those of the model, such as tip_load:fx_n=0.2,fy_n=0,fz_n=0; may be repeated
    #[arg(long, value_name = "NAME:PARAMETER=VALUE,...", value_parser = Effect::parse)]
    effect: Vec<Effect>,
    /// The folder to write to; created if it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// The grid's bends θ, degrees [default: 0:90:5, or as far as the bends that the model was learned on]
    #[arg(long, value_name = "START:STOP:STEP")]
    theta_deg: Option<GridAxis>,
    /// The grid's azimuths δ, degrees; a direction that repeats, such as 180 after -180, is left out
    #[arg(long, value_name = "START:STOP:STEP", allow_hyphen_values = true, default_value_t = Grid::default().delta)]
    delta_deg: GridAxis,
    /// Largest pull (negative) and push that the actuation unit can exert on a backbone, N. The table then has the forces of least strain
    /// within these limits; without them those of Eq. 11, the least strain of all
    #[arg(long, value_name = "PULL,PUSH", value_parser = force_limits, allow_hyphen_values = true)]
    force_limits: Option<ForceLimits>,
    /// Also write OUT/compensation.h, the table for a controller in C, with a lookup that interpolates it
    #[arg(long)]
    c_header: bool,
    #[command(flatten)]
    worth: WorthArgs,
}

#[derive(Serialize)]
struct Summary {
    poses: usize,
    /// The largest correction |q̃ − q| of any backbone, mm.
    largest_correction_mm: f64,
    /// Poses beyond the bends that the model was learned on.
    extrapolated: usize,
    /// Why the table must not be used.
    #[serde(skip_serializing_if = "Option::is_none")]
    do_not_use: Option<String>,
    output: PathBuf,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        const OUTPUTS: [&str; 3] = ["compensation.csv", "compensation.json", "compensation.h"];
        let _out = OutputFolder::claim(&self.output, &OUTPUTS, self.model.as_slice())?;
        let (model, do_not_use) = self.worth.model(console, self.model.as_deref())?;
        let model = with_effects(console, model, &self.effect)?;
        console.warn(model.conditions_of_single_poses());
        let source = self.model.as_deref().map_or("built in".to_owned(), |path| path.display().to_string());
        let theta = self.theta_deg.unwrap_or(Grid::within_data(&model).theta);
        let grid = Grid { theta, delta: self.delta_deg };
        let mut rows = compensation_table(&model, &grid)?;
        tell_of_missed_poses(console, &model, &rows);
        if let Some(limits) = self.force_limits {
            rows = rows.into_iter().map(|row| row.within(&model, &limits)).collect();
        }
        let summary = Summary {
            poses: rows.len(),
            largest_correction_mm: largest_correction_mm(&rows),
            extrapolated: rows.iter().filter(|row| row.extrapolated).count(),
            do_not_use,
            output: self.output.join("compensation.csv"),
        };
        tell_of_learning(console, &model);
        summary.warn(console, &model, &rows);
        let do_not_use = summary.do_not_use.as_deref();
        let stale = self.model.as_deref().and_then(stale_mark);
        let worth = Worth { verdict: None, do_not_use, stale: stale.as_deref() };
        write_compensation_rows(&self.output, (&model, &source), &grid, &rows, worth, self.c_header)?;
        console.result(&summary, || {
            format!(
                "{} poses, largest correction {:.3} mm\n{}",
                summary.poses,
                summary.largest_correction_mm,
                summary.output.display()
            )
        });
        console.next(format_args!("command qc1_mm … of {}", self.output.join("compensation.csv").display()));
        Ok(())
    }
}

impl Summary {
    /// What of the table cannot be relied on.
    fn warn(&self, console: &Console, model: &Model, rows: &[TableRow]) {
        let poses = self.poses;
        let outside = rows.iter().filter(|row| row.sharing.is_some_and(|sharing| !sharing.within)).count();
        console.warn((outside > 0).then(|| format!("{outside} of {poses} poses need forces beyond the limits")));
        let range = match model.learned {
            Some(range) if self.extrapolated > 0 => Some(format!(
                "{} of {poses} poses are beyond the bends that the model was learned on (to {:.1}°, within 45° of δ = {}): extrapolated = 1",
                self.extrapolated,
                range.theta_max().to_degrees(),
                range.directions_deg().iter().map(|delta| format!("{delta:.0}°")).collect::<Vec<_>>().join(", ")
            )),
            _ => None,
        };
        console.warn(range);
    }
}

/// The largest |q̃ − q| of any backbone in a table, mm.
pub fn largest_correction_mm(rows: &[TableRow]) -> f64 {
    rows.iter().map(|row| (row.command_mm - row.q_mm).amax()).fold(0.0, f64::max)
}
