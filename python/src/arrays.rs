//! NumPy arrays to the library's values and back.

use crate::error::wrong;
use numpy::ndarray::{Array2, ArrayD, IxDyn};
use numpy::{AllowTypeChange, Element, IntoPyArray, PyArray2, PyArrayDyn, PyArrayLikeDyn, PyReadonlyArrayDyn};
use pyo3::prelude::*;
use snakeloop::camera::{Frame, Samples};
use snakeloop::robot::PerBackbone;

/// A picture: height × width, grey, or height × width × 3, RGB; 8 or 16 bits.
///
/// The numbers are copied once, by rows where they lie so: while a frame is measured the interpreter's lock is released, and
/// another thread may write into the array. Those of 8 bits are written into the memory of a frame before, `spare`: to get as much from the
/// system anew takes longer than the copy.
///
/// # Errors
/// Anything else.
pub fn frame_of(image: &Bound<'_, PyAny>, spare: Vec<u8>) -> PyResult<Frame> {
    let (shape, samples) = if let Ok(image) = image.extract::<PyReadonlyArrayDyn<u8>>() {
        (image.as_array().shape().to_vec(), Samples::Bits8(copied(&image, spare)))
    } else if let Ok(image) = image.extract::<PyReadonlyArrayDyn<u16>>() {
        (image.as_array().shape().to_vec(), Samples::Bits16(copied(&image, Vec::new())))
    } else {
        let found = match image.getattr("dtype") {
            Ok(dtype) => format!("an array of {dtype}"),
            Err(_) => image.get_type().to_string(),
        };
        return Err(wrong(format!("image: {found}, expected a NumPy array of uint8 or uint16")));
    };
    let (height, width, channels) = match shape[..] {
        [height, width] | [height, width, 1] => (height, width, 1),
        [height, width, 3] => (height, width, 3),
        _ => {
            let message =
                format!("image: shape {shape:?}, expected [height, width] (grey) or [height, width, 3] (RGB)");
            return Err(wrong(message));
        }
    };
    let side = |pixels: usize| {
        u32::try_from(pixels).map_err(|_| wrong(format!("image: {width}×{height} pixels are too many")))
    };
    Ok(Frame { width: side(width)?, height: side(height)?, channels, samples })
}

/// The numbers by rows, in place of those that are `into`.
fn copied<T: Element + Copy>(array: &PyReadonlyArrayDyn<T>, mut into: Vec<T>) -> Vec<T> {
    let array = array.as_array();
    into.clear();
    match array.as_slice() {
        Some(numbers) => into.extend_from_slice(numbers),
        None => into.extend(array.iter().copied()),
    }
    into
}

/// Angles, rad, from what was given in radians or in degrees.
///
/// # Errors
/// Neither or both were given; what is no array of numbers.
pub fn radians_of<'py>(
    name: &str,
    radians: Option<Bound<'py, PyAny>>,
    degrees: Option<Bound<'py, PyAny>>,
) -> PyResult<ArrayD<f64>> {
    match (radians, degrees) {
        (Some(radians), None) => numbers_of(&radians),
        (None, Some(degrees)) => Ok(numbers_of(&degrees)?.mapv_into(f64::to_radians)),
        _ => Err(wrong(format!("give either {name} (radians) or {name}_deg (degrees)"))),
    }
}

/// A number, a list or an array of numbers.
///
/// # Errors
/// What NumPy cannot make an array of numbers from.
pub fn numbers_of(numbers: &Bound<'_, PyAny>) -> PyResult<ArrayD<f64>> {
    Ok(numbers.extract::<PyArrayLikeDyn<f64, AllowTypeChange>>()?.as_array().to_owned())
}

/// Readings of the backbones, in mm: shape (n,) or (…, n), one row a pose.
///
/// # Errors
/// Another number of backbones.
pub fn readings_of(q_mm: &Bound<'_, PyAny>, backbones: usize) -> PyResult<(Vec<usize>, Vec<PerBackbone>)> {
    let q_mm = numbers_of(q_mm)?;
    let Some((&width, poses)) = q_mm.shape().split_last().filter(|(width, _)| **width == backbones) else {
        let shape = q_mm.shape();
        return Err(wrong(format!(
            "q_mm: shape {shape:?}, expected […, {backbones}]: the robot has {backbones} backbones"
        )));
    };
    let values: Vec<f64> = q_mm.iter().copied().collect();
    let rows = values.chunks_exact(width).map(|row| PerBackbone::from_fn(width, |i| row[i])).collect();
    Ok((poses.to_vec(), rows))
}

/// An array of this shape from its numbers by rows.
///
/// # Errors
/// Never: there are as many numbers as the shape asks for.
pub fn shaped<'py>(py: Python<'py>, shape: &[usize], numbers: Vec<f64>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let array = ArrayD::from_shape_vec(IxDyn(shape), numbers).map_err(|e| wrong(e.to_string()))?;
    Ok(array.into_pyarray(py))
}

/// A matrix.
pub fn matrix<'py>(py: Python<'py>, matrix: &nalgebra::Matrix2<f64>) -> Bound<'py, PyArray2<f64>> {
    Array2::from_shape_fn((2, 2), |at| matrix[at]).into_pyarray(py)
}
