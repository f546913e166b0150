//! One figure of the paper beside the program's, and what the paper found.

use serde::Serialize;

/// η as the paper found it. Source: Table III's last row.
pub const PAPER_ETA: f64 = 1.221;
/// λ as the paper found it, mm. Source: Table III's last row.
pub const PAPER_LAMBDA_MM: f64 = 0.1765;

/// One figure of the paper beside the program's.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Where in the paper it stands.
    pub place: &'static str,
    /// What it is.
    pub quantity: String,
    /// Its unit, `1` for a number without.
    pub unit: &'static str,
    /// What the paper prints; `None` where it prints a picture or a sentence.
    pub paper: Option<f64>,
    /// What this program computes.
    pub ours: f64,
    /// Why they differ, or what the paper says in words.
    pub explanation: String,
}

impl Comparison {
    /// One comparison.
    pub fn new(
        place: &'static str,
        quantity: impl Into<String>,
        unit: &'static str,
        paper: impl Into<Option<f64>>,
        ours: f64,
        explanation: impl Into<String>,
    ) -> Self {
        let (quantity, explanation) = (quantity.into(), explanation.into());
        Self { place, quantity, unit, paper: paper.into(), ours, explanation }
    }

    /// Ours less the paper's, where the paper prints a number.
    pub fn difference(&self) -> Option<f64> {
        self.paper.map(|paper| self.ours - paper)
    }
}
