//! `print`: the grid target and the chessboard as PDF files that a printer puts on paper to scale.

use super::console::Console;
use crate::cli::failure::Failure;
use crate::record::write_atomically;
use crate::report::sheet::{Chessboard, GridTarget, Paper, RULER_MM, chessboard_pdf, grid_pdf};
use serde::Serialize;
use std::path::PathBuf;

/// Make a target to print, as a PDF to scale with a ruler that checks the printer
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop print grid --paper a4 -o grid.pdf")]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    Grid(GridArgs),
    Chessboard(ChessboardArgs),
}

/// The grid target behind the snake: evenly spaced lines, heavier ones every 5 and 10
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop print grid --paper a4 -o grid.pdf")]
pub struct GridArgs {
    /// The paper
    #[arg(long, value_enum, default_value_t = Paper::A4)]
    paper: Paper,
    /// Distance between neighbouring thin lines, mm: grid_pitch_mm of experiment.toml
    #[arg(long, value_name = "MM", default_value_t = 1.0)]
    pitch: f64,
    /// The file to write
    #[arg(short, long, value_name = "PDF", default_value = "grid.pdf")]
    output: PathBuf,
}

/// The chessboard for `calibrate camera`
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop print chessboard --paper letter -o chessboard.pdf")]
pub struct ChessboardArgs {
    /// The paper
    #[arg(long, value_enum, default_value_t = Paper::A4)]
    paper: Paper,
    /// Inner corners along a row and along a column, as `calibrate camera` takes them; the squares are one more each way
    #[arg(long, value_name = "COLUMNSxROWS", value_parser = super::calibrate::corners, default_value = "9x6")]
    corners: (usize, usize),
    /// Side of a square, mm
    #[arg(long, value_name = "MM", default_value_t = 25.0)]
    square: f64,
    /// The file to write
    #[arg(short, long, value_name = "PDF", default_value = "chessboard.pdf")]
    output: PathBuf,
}

#[derive(Serialize)]
struct Summary {
    output: PathBuf,
    /// What the ruler on the sheet must measure, mm.
    ruler_mm: f64,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        let (pdf, output) = match &self.what {
            What::Grid(args) => (grid_pdf(args.paper, &GridTarget { pitch_mm: args.pitch }), &args.output),
            What::Chessboard(ChessboardArgs { paper, corners, square, output }) => {
                (chessboard_pdf(*paper, &Chessboard { corners: *corners, square_mm: *square }), output)
            }
        };
        write_atomically(output, &pdf.map_err(Failure::Usage)?)?;
        let summary = Summary { output: output.clone(), ruler_mm: RULER_MM };
        console.result(&summary, || {
            format!(
                "{}\nprint it at 100 % (\"actual size\"); the ruler on it must then be {} mm long",
                summary.output.display(),
                summary.ruler_mm
            )
        });
        Ok(())
    }
}
