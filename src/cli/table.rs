//! `table`: the compensation table on any grid.

use super::console::Console;
use super::inputs::model_or_paper;
use crate::Result;
use crate::record::write_compensation;
use crate::robot::{Grid, GridAxis, TableRow};
use serde::Serialize;
use std::path::PathBuf;

/// Tabulate what to command for every pose of a grid: writes OUT/compensation.csv and OUT/compensation.json
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  snakeloop table --model out/model.toml --theta-deg 0:90:2 --delta-deg=-180:180:10 -o out"
)]
pub struct Args {
    /// The model (model.toml); without it the paper's, with Table I
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// The folder to write to; created where it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// The grid's bends θ, degrees
    #[arg(long, value_name = "START:STOP:STEP", default_value_t = Grid::default().theta)]
    theta_deg: GridAxis,
    /// The grid's azimuths δ, degrees
    #[arg(long, value_name = "START:STOP:STEP", allow_hyphen_values = true, default_value_t = Grid::default().delta)]
    delta_deg: GridAxis,
}

#[derive(Serialize)]
struct Summary {
    poses: usize,
    /// The largest correction |q̃ − q| of any backbone, mm.
    largest_correction_mm: f64,
    output: PathBuf,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<()> {
        let model = model_or_paper(self.model.as_deref())?;
        let source = self.model.as_deref().map_or("built in".to_owned(), |path| path.display().to_string());
        let grid = Grid { theta: self.theta_deg, delta: self.delta_deg };
        let rows = write_compensation(&self.output, &model, &source, &grid)?;
        let summary = Summary {
            poses: rows.len(),
            largest_correction_mm: largest_correction_mm(&rows),
            output: self.output.join("compensation.csv"),
        };
        console.result(&summary, || {
            format!(
                "{} poses, largest correction {:.3} mm\n{}",
                summary.poses,
                summary.largest_correction_mm,
                summary.output.display()
            )
        });
        Ok(())
    }
}

/// The largest |q̃ − q| of any backbone in a table, mm.
pub fn largest_correction_mm(rows: &[TableRow]) -> f64 {
    rows.iter().map(|row| (row.command_mm - row.q_mm).amax()).fold(0.0, f64::max)
}
