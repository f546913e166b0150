//! `calibrate friction`: Table II's fit, with the paper's figures beside it.

use crate::Result;
use crate::cli::console::Console;
use crate::cli::failure::Failure;
use crate::cli::inputs::{model_or_paper, rows};
use crate::record::{read_friction, write_model};
use crate::robot::friction::{STANDARD_GRAVITY, table_ii};
use crate::robot::{FrictionFit, Model};
use serde::Serialize;
use std::path::PathBuf;

/// The gravity that the paper's f_s takes, m/s². Derived: the printed 1.959 N over the 195.87 gf of Table II.
const PAPER_GRAVITY: f64 = 10.0;
/// The load at which the paper's dμ holds, g. Derived: from Eq. 14.
const PAPER_LOAD_G: f64 = 800.0;

/// Fit the cone's friction coefficient and static friction (Table II)
///
/// Prints the least-squares fit with standard errors, and the paper's value beside the corrected one.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop calibrate friction calib/friction.csv -o model.toml")]
pub struct Args {
    /// The weighings (index,tau_g,tau_limit_g,tau_tilde_g,tau_tilde_limit_g); without it the paper's Table II
    weighings: Option<PathBuf>,
    /// The model that gives robot and cone angle (model.toml); by default the paper's
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// Write the model with the fitted friction there (model.toml)
    #[arg(short, long, value_name = "MODEL")]
    output: Option<PathBuf>,
}

#[derive(Serialize)]
struct Fitted {
    samples: usize,
    mu: f64,
    sd_mu: f64,
    /// At standard gravity.
    static_force_n: f64,
    sd_static_force_n: f64,
    /// At g = 10 m/s², as the paper has it.
    static_force_n_at_g10: f64,
    sd_static_force_n_at_g10: f64,
    /// Eq. 14 with the stated limits of error.
    limit_static_force_n: f64,
    limit_mu_at_800_g: f64,
    scatter_g: f64,
    paper_mu: f64,
    paper_static_force_n: f64,
    paper_limit_static_force_n: f64,
    paper_limit_mu: f64,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        let weighings = match &self.weighings {
            Some(path) => rows(console, read_friction(path)?),
            None => table_ii(),
        };
        let model = model_or_paper(console, self.model.as_deref())?;
        let fit = FrictionFit::of(&weighings, model.robot.line.cone_bend_angle())?;
        if let Some(path) = &self.output {
            write_model(path, &Model { friction: fit.friction(), ..model })?;
        }
        let fitted = Fitted::from(&fit);
        console.result(&fitted, || fitted.text());
        Ok(())
    }
}

impl From<&FrictionFit> for Fitted {
    fn from(fit: &FrictionFit) -> Self {
        let (static_force_n, sd_static_force_n) = fit.static_force_n(STANDARD_GRAVITY);
        let (static_force_n_at_g10, sd_static_force_n_at_g10) = fit.static_force_n(PAPER_GRAVITY);
        Self {
            samples: fit.samples,
            mu: fit.mu,
            sd_mu: fit.sd_mu(),
            static_force_n,
            sd_static_force_n,
            static_force_n_at_g10,
            sd_static_force_n_at_g10,
            limit_static_force_n: fit.static_force_limit_n(),
            limit_mu_at_800_g: fit.mu_limit(PAPER_LOAD_G),
            scatter_g: fit.scatter_g,
            paper_mu: FrictionFit::PAPER_MU,
            paper_static_force_n: FrictionFit::PAPER_STATIC_FORCE_N,
            paper_limit_static_force_n: FrictionFit::PAPER_STATIC_FORCE_LIMIT_N,
            paper_limit_mu: FrictionFit::PAPER_MU_LIMIT,
        }
    }
}

impl Fitted {
    fn text(&self) -> String {
        format!(
            "{} weighings, scatter about the line {:.1} g\n\n\
             {:30}{:22}paper\n\
             {:30}{:22}{}\n\
             {:30}{:22}\n\
             {:30}{:22}{} N\n\
             {:30}{:22}{} N\n\
             {:30}{:22}{}\n",
            self.samples,
            self.scatter_g,
            "",
            "fit ± standard error",
            "mu",
            format!("{:.4} ± {:.4}", self.mu, self.sd_mu),
            self.paper_mu,
            "f_s at standard gravity",
            format!("{:.3} ± {:.3} N", self.static_force_n, self.sd_static_force_n),
            "f_s at g = 10 m/s²",
            format!("{:.3} ± {:.3} N", self.static_force_n_at_g10, self.sd_static_force_n_at_g10),
            self.paper_static_force_n,
            "limit of f_s (Eq. 14)",
            format!("{:.3} N", self.limit_static_force_n),
            self.paper_limit_static_force_n,
            "limit of mu at 800 g (Eq. 14)",
            format!("{:.4}", self.limit_mu_at_800_g),
            self.paper_limit_mu,
        )
    }
}
