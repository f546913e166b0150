//! estimate.csv: how η and λ moved with each measurement.
//!
//! | column | meaning |
//! | --- | --- |
//! | `index`, `time_s` | the frame |
//! | `eta`, `lambda_mm`, `sd_eta`, `sd_lambda_mm` | the estimate after this measurement; empty before the first |
//! | `status` | `used`, `rejected` (by the outlier gate) or `skipped` (there was nothing to use) |
//! | `reason` | why it was not used |
//! | `residual1_mm` … `residualn_mm` | measured ε less the ε that the estimate before it predicted, per backbone |
//! | `view` | the view's name in experiment.toml |

use super::columns::{backbone_columns, backbone_decimals, csv_text, decimals, decimals_or_empty};
use crate::estimate::EstimateRow;

/// The estimate.csv of a robot of so many backbones as text; lengths to 1 nm.
pub fn estimates_csv(rows: &[EstimateRow], backbones: usize) -> String {
    csv_text([columns(backbones)].into_iter().chain(rows.iter().map(|row| fields(row, backbones))))
}

fn columns(backbones: usize) -> Vec<String> {
    let estimate =
        ["index", "time_s", "eta", "lambda_mm", "sd_eta", "sd_lambda_mm", "status", "reason"].map(str::to_owned);
    estimate.into_iter().chain(backbone_columns("residual", "mm", backbones)).chain(["view".to_owned()]).collect()
}

fn fields(row: &EstimateRow, backbones: usize) -> Vec<String> {
    let estimate: [String; 4] = row.estimate.map_or_else(Default::default, |e| {
        [e.eta, e.lambda_mm, e.sd_eta, e.sd_lambda_mm].map(|value| decimals(value, 6))
    });
    let empty = || vec![String::new(); backbones];
    [
        &[row.index.to_string(), decimals_or_empty(row.time_s, 4)],
        &estimate[..],
        &[row.verdict.to_string(), row.reason.clone()],
        &row.residual_mm.map_or_else(empty, |mm| backbone_decimals(&mm, 6).collect()),
        &[row.view.clone().unwrap_or_default()],
    ]
    .concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{EtaLambda, Verdict};
    use crate::robot::PerBackbone;

    #[test]
    fn one_row_a_measurement_whatever_became_of_it() {
        let rows = [
            EstimateRow {
                index: 0,
                time_s: Some(0.25),
                estimate: None,
                verdict: Verdict::Skipped,
                reason: "no_snake".into(),
                residual_mm: None,
                view: None,
            },
            EstimateRow {
                index: 4,
                time_s: None,
                estimate: Some(EtaLambda { eta: 1.221, lambda_mm: 0.1765, sd_eta: 0.01, sd_lambda_mm: 0.002 }),
                verdict: Verdict::Used,
                reason: String::new(),
                residual_mm: Some(PerBackbone::from([0.001, -0.002, 0.0])),
                view: Some("side".into()),
            },
        ];
        assert_eq!(
            estimates_csv(&rows, 3),
            "index,time_s,eta,lambda_mm,sd_eta,sd_lambda_mm,status,reason,residual1_mm,residual2_mm,residual3_mm,view\n\
             0,0.2500,,,,,skipped,no_snake,,,,\n\
             4,,1.221000,0.176500,0.010000,0.002000,used,,0.001000,-0.002000,0.000000,side\n"
        );
    }
}
