//! The joint covariance of a model's parameters as model.toml shows it.

use super::effect_table::EffectTable;
use crate::error::Result;
use crate::robot::Model;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

/// Numbers that a person copied agree with each other to this share.
///
/// Convention: more than the six digits that one writes by hand.
const AGREES: f64 = 1e-6;

/// The table `[covariance]`.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CovarianceTable {
    /// What the rows and columns belong to.
    of: Vec<String>,
    /// The matrix, row by row.
    matrix: Vec<Vec<f64>>,
}

impl CovarianceTable {
    /// Of a model; none where no effect has an uncertain parameter, since then η, λ, their sds and their correlation say it all.
    pub(super) fn of(model: &Model) -> Option<Self> {
        let covariance = model.covariance();
        let rows = || covariance.row_iter().map(|row| row.iter().copied().collect());
        let uncertain = covariance.diagonal().iter().skip(2).any(|variance| *variance > 0.0);
        uncertain.then(|| Self { of: model.parameter_names(), matrix: rows().collect() })
    }

    /// The matrix: of the model's parameters, finite, symmetric, with the squares of the sds on its diagonal, and without
    /// correlations above 1.
    pub(super) fn matrix(&self, model: &Model, sds: &[f64]) -> Result<DMatrix<f64>, String> {
        let names = model.parameter_names();
        let n = names.len();
        let wrong = |what: String| Err(format!("covariance: {what}"));
        if self.of != names {
            return wrong(format!("of is {:?}, expected {names:?}", self.of));
        }
        if self.matrix.len() != n || self.matrix.iter().any(|row| row.len() != n) {
            return wrong(format!("expected {n} rows of {n} numbers"));
        }
        let matrix = DMatrix::from_fn(n, n, |a, b| self.matrix[a][b]);
        checked(&matrix, &names, sds).or_else(wrong)
    }
}

/// A matrix that can be a covariance with these sds; else what is wrong with it.
fn checked(matrix: &DMatrix<f64>, names: &[String], sds: &[f64]) -> Result<DMatrix<f64>, String> {
    if let Some(a) = (0..names.len()).find(|a| matrix.row(*a).iter().any(|value| !value.is_finite())) {
        return Err(format!("the row of {} has a number that is not finite", names[a]));
    }
    for (a, name) in names.iter().enumerate() {
        let variance = matrix[(a, a)];
        if !(variance >= 0.0 && (variance.sqrt() - sds[a]).abs() <= AGREES * sds[a]) {
            return Err(format!("the variance of {name} is {variance}, expected the square of its sd, {}", sds[a]));
        }
        for (b, other) in names.iter().enumerate() {
            let (value, limit) = (matrix[(a, b)], (1.0 + AGREES) * sds[a] * sds[b]);
            if value.abs() > limit || (value - matrix[(b, a)]).abs() > AGREES * limit {
                return Err(format!(
                    "{value} for {name} and {other}, expected a symmetric matrix without correlations above 1"
                ));
            }
        }
    }
    Ok(matrix.clone())
}

/// What the tables of the estimate and of the effects say of the covariance, parameter by parameter.
pub(super) struct Known {
    /// Standard deviations of η, λ and the effects' parameters so far.
    pub(super) sds: Vec<f64>,
    /// The lower half of the matrix.
    rows: Vec<Vec<f64>>,
}

impl Known {
    /// Of a model without effects.
    pub(super) fn of(model: &Model) -> Self {
        let p = model.parameter_covariance();
        Self { sds: vec![p[(0, 0)].sqrt(), p[(1, 1)].sqrt()], rows: vec![vec![p[(0, 0)]], vec![p[(1, 0)], p[(1, 1)]]] }
    }

    /// Adds the last effect of a model, which this table tells of.
    pub(super) fn add(&mut self, model: &Model, table: &EffectTable) -> Result<(), String> {
        let Some(effect) = model.effects.last() else { return Ok(()) };
        let before = self.sds.len();
        let sd = |name: &str| table.parameters.get(name).map_or(0.0, |parameter| parameter.sd);
        self.sds.extend(effect.parameters().iter().map(|spec| sd(spec.name)));
        if table.covariance.is_empty() && table.covariance_of.is_empty() {
            for a in before..self.sds.len() {
                let row = (0..=a).map(|b| if a == b { self.sds[a].powi(2) } else { 0.0 });
                self.rows.push(row.collect());
            }
            return Ok(());
        }
        let names = model.parameter_names();
        let (n, count) = (names.len(), names.len() - before);
        let wrong = |what: String| Err(format!("effect {}: covariance: {what}", table.name));
        if table.covariance_of != names {
            return wrong(format!("covariance_of is {:?}, expected {names:?}", table.covariance_of));
        }
        if table.covariance.len() != count || table.covariance.iter().any(|row| row.len() != n) {
            return wrong(format!("expected {count} rows of {n} numbers"));
        }
        let own = DMatrix::from_fn(count, count, |a, b| table.covariance[a][before + b]);
        if let Err(what) = checked(&own, &names[before..], &self.sds[before..]) {
            return wrong(what);
        }
        if table.covariance.iter().flatten().any(|value| !value.is_finite()) {
            return wrong("a number is not finite".into());
        }
        self.rows.extend(table.covariance.iter().enumerate().map(|(a, row)| row[..=before + a].to_vec()));
        Ok(())
    }

    /// The whole matrix.
    pub(super) fn matrix(&self) -> DMatrix<f64> {
        let n = self.rows.len();
        DMatrix::from_fn(n, n, |a, b| self.rows[a.max(b)][a.min(b)])
    }
}

#[cfg(test)]
mod tests {
    use crate::record::model::model_toml;
    use crate::record::model::tests::{estimated, message, read_text};
    use crate::robot::{Effect, Model};
    use nalgebra::DMatrix;

    fn with_effects() -> Model {
        let mut model = estimated();
        let play =
            Effect::new("motion_directed_backlash", Some("crossed by travel"), &[("half_gap_mm".to_owned(), 0.4)], 3);
        let creep = Effect::parse("creep:share=0.1,time_constant_s=4").unwrap();
        model.effects = vec![play.unwrap(), Effect { found: "a test".to_owned(), ..creep }];
        model
    }

    /// Standard deviations of `with_effects`' parameters, and correlations that a covariance can have.
    fn covariance() -> DMatrix<f64> {
        let sds = [4e-3, 6e-4, 0.1, 0.01, 0.3];
        DMatrix::from_fn(5, 5, |a, b| {
            sds[a] * sds[b] * if a == b { 1.0 } else { 0.5f64.powi((a as i32 - b as i32).abs()) }
        })
    }

    #[test]
    fn effects_come_back_as_they_were_written() {
        let mut model = with_effects();
        let text = model_toml(&model).unwrap();
        assert!(!text.contains("covariance") || text.contains("[covariance]"), "{text}");
        assert_eq!(read_text(&text).unwrap().effects, model.effects, "{text}");
        model.covariance = covariance();
        let text = model_toml(&model).unwrap();
        let back = read_text(&text).unwrap();
        assert_eq!(back.effects, model.effects, "{text}");
        assert!((back.covariance() - covariance()).amax() < 1e-15, "{text}");
        assert_eq!(model_toml(&back).unwrap(), text, "what was read is written as it was");
    }

    #[test]
    fn a_covariance_that_cannot_be_is_named() {
        let mut model = with_effects();
        model.covariance = covariance();
        let text = model_toml(&model).unwrap();
        let number = |a: usize, b: usize| toml::Value::from(model.covariance()[(a, b)]).to_string();
        for (from, to, what) in [
            ("form = \"crossed by travel\"".to_owned(), "form = \"sideways\"".to_owned(), "form \"sideways\""),
            ("unit = \"s\"".to_owned(), "unit = \"min\"".to_owned(), "expected an sd"),
            ("\"creep.share\", ".to_owned(), String::new(), "of is"),
            (number(4, 4), "0.08".to_owned(), "expected the square of its sd"),
            (number(3, 4), "2e-3".to_owned(), "expected a symmetric matrix"),
            (number(2, 4), "inf".to_owned(), "not finite"),
            ("sd = 0.01".to_owned(), "sd = 0.02".to_owned(), "expected the square of its sd"),
        ] {
            // The matrix comes last: the last place is in it.
            let at = text.rfind(&from).unwrap_or_else(|| panic!("{from}: {text}"));
            let message = message(&format!("{}{to}{}", &text[..at], &text[at + from.len()..]));
            assert!(message.contains(what) && message.contains("lab/model.toml:"), "{message}");
        }
    }

    #[test]
    fn a_file_with_the_covariances_in_its_effects_is_read() {
        let text = model_toml(&estimated()).unwrap();
        let old = format!(
            "{text}[[effect]]\nname = \"motion_directed_backlash\"\nform = \"crossed by travel\"\n\
             parameters.half_gap_mm = {{ value = 0.4, sd = 0.1, unit = \"mm\" }}\n\
             covariance_of = [\"eta\", \"lambda_mm\", \"motion_directed_backlash.half_gap_mm\"]\n\
             covariance = [[1e-4, -2e-5, 0.01]]\n\
             [[effect]]\nname = \"creep\"\nfound = \"a test\"\n\
             parameters.share = {{ value = 0.1, sd = 0.01, unit = \"1\" }}\n\
             parameters.time_constant_s = {{ value = 4.0, sd = 0.3, unit = \"s\" }}\n\
             covariance_of = [\"eta\", \"lambda_mm\", \"motion_directed_backlash.half_gap_mm\", \"creep.share\", \
             \"creep.time_constant_s\"]\n\
             covariance = [[0.0, 1e-6, 2e-4, 1e-4, 1e-3], [2.5e-4, 0.0, 3e-3, 1e-3, 0.09]]\n"
        );
        let model = read_text(&old).unwrap();
        assert_eq!(model.effects, with_effects().effects);
        let p = model.covariance();
        assert_eq!((p[(2, 0)], p[(0, 2)], p[(1, 2)], p[(3, 2)]), (1e-4, 1e-4, -2e-5, 2e-4));
        assert_eq!((p[(4, 3)], p[(4, 4)], model.effect_sds(1)), (1e-3, 0.09, vec![0.01, 0.3]));
        assert!((p.fixed_view::<2, 2>(0, 0) - estimated().parameter_covariance()).amax() < 1e-18);
        // It is written as one matrix, and stays what it was.
        assert!((read_text(&model_toml(&model).unwrap()).unwrap().covariance() - p).amax() < 1e-15);
        let wrong = old.replace("covariance = [[1e-4, ", "covariance = [[");
        assert!(message(&wrong).contains("expected 1 rows of 3 numbers"), "{}", message(&wrong));
        // Sds without a covariance are those of errors that have nothing to do with each other.
        let alone: String =
            old.lines().filter(|line| !line.starts_with("covariance")).map(|l| format!("{l}\n")).collect();
        assert_eq!(read_text(&alone).unwrap().effect_sds(1), [0.01, 0.3]);
    }
}
