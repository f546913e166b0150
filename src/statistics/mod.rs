//! The statistical tools that the rest of the library is built with, each under its textbook name.
//!
//! This module stands at the bottom: it knows numbers only, no snake, no camera and no file. Each tool's page gives its formula
//! and its source, and each is tested by itself against a closed form, a simulation or a published example.
//!
//! | tool | for |
//! | --- | --- |
//! | [`least_squares`] | nonlinear least squares: Levenberg–Marquardt with box bounds and a robust loss |
//! | [`normal_equations`] | those of weighted linear least squares |
//! | [`projection`] | what columns have beyond the span of others |
//! | [`robust`] | losses of Huber and Tukey, weights in units of the MAD, iteratively reweighted least squares (IRLS) |
//! | [`trimmed`] | least trimmed squares (LTS): a start that outliers cannot spoil |
//! | [`chi_square`] | quantiles of χ² |
//! | [`normal`] | quantiles of the normal distribution |
//! | [`student`] | quantiles of Student's t |
//! | [`cluster`] | cluster-robust covariance of a fit whose errors come in groups |
//! | [`correlation`] | autocorrelation and design effect of errors that come in order |
//! | [`information`] | square-root information filter: recursive least squares with a forgetting factor |
//! | [`line`](mod@line) | a straight line through pairs of numbers |
//! | [`order`] | median, MAD and quantiles |
//! | [`moments`] | mean, standard deviation and root mean square |
//! | [`bootstrap`] | seeded bootstrap over blocks |
//! | [`sign_flip`] | whether paired gains have a mean above zero |
//! | [`binomial`] | the exact binomial test, and the sign test of a median |
//! | [`spread`] | a bounded number of things, spread evenly over all that come |
//! | [`null_distribution`] | quantiles of a statistic that was simulated under the null hypothesis |

pub mod binomial;
pub mod bootstrap;
pub mod chi_square;
pub mod cluster;
pub mod correlation;
pub mod information;
pub mod least_squares;
pub mod line;
pub mod moments;
pub mod normal;
pub mod normal_equations;
pub mod null_distribution;
pub mod order;
pub mod projection;
pub mod robust;
pub mod sign_flip;
pub mod spread;
pub mod student;
pub mod trimmed;
