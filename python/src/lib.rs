//! The Python package `snakeloop`: a thin shell over the library. Here arrays and tables become the library's values and back, and
//! nothing is computed. The stubs in `snakeloop/__init__.pyi` say what a caller sees.

mod arrays;
mod discovery;
mod error;
mod estimator;
mod eye;
mod json;
mod line_and_load;
mod model;
mod robot;
mod run;
mod simulation;
mod tables;
mod threads;
mod verdict;

use pyo3::prelude::*;

#[pymodule]
mod _snakeloop {
    #[pymodule_export]
    use super::discovery::{PyDiscovery, discover};
    #[pymodule_export]
    use super::error::SnakeloopError;
    #[pymodule_export]
    use super::estimator::{PyEstimator, PyStep};
    #[pymodule_export]
    use super::eye::{PyEye, PyLens, PyMeasurement, PyRig, fused};
    #[pymodule_export]
    use super::line_and_load::{PyStemEstimate, PyTipForce, estimate_stem_of, tip_force_of};
    #[pymodule_export]
    use super::model::PyModel;
    #[pymodule_export]
    use super::robot::PyRobot;
    #[pymodule_export]
    use super::run::{PyEstimate, PyRun, estimate, run};
    #[pymodule_export]
    use super::simulation::simulate;
    #[pymodule_export]
    use super::verdict::PyVerdict;
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        // What an error without a file says.
        let error = module.py().get_type::<SnakeloopError>();
        error.setattr("path", module.py().None())?;
        error.setattr("line", module.py().None())
    }
}
