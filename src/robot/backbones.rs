//! One thing for each secondary backbone, however many the robot has.

use nalgebra::{Matrix2, Vector2};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::ops::{Add, AddAssign, Deref, DerefMut, Div, Mul, Neg, RangeInclusive, Sub};

/// How many secondary backbones a robot can have: with fewer than three it cannot be bent to all sides.
///
/// Convention: the upper end is the room that [`PerBackbone`] has.
pub const BACKBONES: RangeInclusive<usize> = 3..=MOST;

/// The room that there is for them, so that nothing need be allocated in the loops that run at the camera's pace.
///
/// Convention: a resource limit.
const MOST: usize = 8;

/// One value for each secondary backbone, element 0 being backbone 1.
///
/// `PerBackbone<Vector2<f64>>` is a matrix: n × 2, one row for each backbone. Times a `Vector2` it gives a number for each backbone
/// (q = Q b); its transpose times numbers of the backbones ([`tr_mul`](Self::tr_mul)) gives a `Vector2` (b = Q⁺q, Q⁺ being kept
/// by its columns).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PerBackbone<T = f64> {
    /// What lies beyond `count` is the default.
    values: [T; MOST],
    count: usize,
}

impl<T: Copy + Default> PerBackbone<T> {
    /// From a function of the index, from 0. A count beyond [`BACKBONES`] is cut off.
    pub fn from_fn(count: usize, mut value: impl FnMut(usize) -> T) -> Self {
        let mut new = Self { values: [T::default(); MOST], count: count.min(MOST) };
        for i in 0..new.count {
            new.values[i] = value(i);
        }
        new
    }

    /// The same for each.
    pub fn repeat(count: usize, value: T) -> Self {
        Self::from_fn(count, |_| value)
    }

    /// From a list; `None` where it is too long.
    pub fn of(values: &[T]) -> Option<Self> {
        (values.len() <= MOST).then(|| Self::from_fn(values.len(), |i| values[i]))
    }

    /// A function of each.
    pub fn map<U: Copy + Default>(&self, mut f: impl FnMut(T) -> U) -> PerBackbone<U> {
        PerBackbone::from_fn(self.count, |i| f(self.values[i]))
    }

    /// A function of each and its counterpart.
    pub fn zip_map<U: Copy + Default, V: Copy + Default>(
        &self,
        other: &PerBackbone<U>,
        mut f: impl FnMut(T, U) -> V,
    ) -> PerBackbone<V> {
        debug_assert_eq!(self.count, other.count);
        PerBackbone::from_fn(self.count, |i| f(self.values[i], other.values[i]))
    }
}

impl<T: Copy + Default, const N: usize> From<[T; N]> for PerBackbone<T> {
    fn from(values: [T; N]) -> Self {
        const { assert!(N <= MOST) }
        Self::from_fn(N, |i| values[i])
    }
}

impl<T> Deref for PerBackbone<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.values[..self.count]
    }
}

impl<T> DerefMut for PerBackbone<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.values[..self.count]
    }
}

impl<'a, T> IntoIterator for &'a PerBackbone<T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl<T: Serialize> Serialize for PerBackbone<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self)
    }
}

impl<'de, T: Copy + Default + Deserialize<'de>> Deserialize<'de> for PerBackbone<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let values = Vec::<T>::deserialize(deserializer)?;
        Self::of(&values).ok_or_else(|| D::Error::custom(format!("{} values, expected {MOST} at most", values.len())))
    }
}

impl<T: Copy + Default + Add<Output = T>> Add for PerBackbone<T> {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        self.zip_map(&other, |a, b| a + b)
    }
}

impl<T: Copy + Default + Add<Output = T>> AddAssign for PerBackbone<T> {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<T: Copy + Default + Sub<Output = T>> Sub for PerBackbone<T> {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self.zip_map(&other, |a, b| a - b)
    }
}

impl<T: Copy + Default + Neg<Output = T>> Neg for PerBackbone<T> {
    type Output = Self;

    fn neg(self) -> Self {
        self.map(|a| -a)
    }
}

impl<T: Copy + Default + Mul<f64, Output = T>> Mul<f64> for PerBackbone<T> {
    type Output = Self;

    fn mul(self, scale: f64) -> Self {
        self.map(|a| a * scale)
    }
}

impl<T: Copy + Default + Div<f64, Output = T>> Div<f64> for PerBackbone<T> {
    type Output = Self;

    fn div(self, scale: f64) -> Self {
        self.map(|a| a / scale)
    }
}

impl PerBackbone {
    /// 1 for backbone i, counted from 0, and 0 for the others.
    pub fn ith(count: usize, i: usize) -> Self {
        Self::from_fn(count, |j| f64::from(u8::from(i == j)))
    }

    /// The sum.
    pub fn sum(&self) -> f64 {
        self.iter().sum()
    }

    /// The part that all have in common.
    pub fn mean(&self) -> f64 {
        self.sum() / self.count as f64
    }

    /// The sum of the products.
    pub fn dot(&self, other: &Self) -> f64 {
        self.component_mul(other).sum()
    }

    /// The sum of the squares.
    pub fn norm_squared(&self) -> f64 {
        self.dot(self)
    }

    /// The root of the sum of the squares.
    pub fn norm(&self) -> f64 {
        self.norm_squared().sqrt()
    }

    /// The largest absolute value.
    pub fn amax(&self) -> f64 {
        self.iter().fold(0.0, |most, x| most.max(x.abs()))
    }

    /// The least.
    pub fn min(&self) -> f64 {
        self.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// The largest.
    pub fn max(&self) -> f64 {
        self.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    /// The same added to each.
    pub fn add_scalar(&self, summand: f64) -> Self {
        self.map(|x| x + summand)
    }

    /// Products, one by one.
    pub fn component_mul(&self, other: &Self) -> Self {
        self.zip_map(other, |a, b| a * b)
    }

    /// Quotients, one by one.
    pub fn component_div(&self, other: &Self) -> Self {
        self.zip_map(other, |a, b| a / b)
    }
}

impl PerBackbone<Vector2<f64>> {
    /// From two columns.
    pub fn from_columns([first, second]: [PerBackbone; 2]) -> Self {
        first.zip_map(&second, Vector2::new)
    }

    /// Column 0 or 1.
    pub fn column(&self, axis: usize) -> PerBackbone {
        self.map(|row| row[axis])
    }

    /// Aᵗx = Σ x_i a_i: the transpose of this matrix (rows a_i) times numbers of the backbones.
    pub fn tr_mul(&self, x: &PerBackbone) -> Vector2<f64> {
        debug_assert_eq!(self.count, x.count);
        self.iter().zip(x).fold(Vector2::zeros(), |sum, (v, &x)| sum + v * x)
    }

    /// AᵗB = Σ a_i b_iᵗ, the cross Gram matrix of two matrices with rows a_i and b_i; with itself the Gram matrix AᵗA.
    pub fn cross_gram(&self, other: &Self) -> Matrix2<f64> {
        self.iter().zip(other).fold(Matrix2::zeros(), |sum, (u, v)| sum + u * v.transpose())
    }

    /// The Frobenius norm.
    pub fn norm(&self) -> f64 {
        self.cross_gram(self).trace().sqrt()
    }
}

/// A matrix of rows times a vector.
impl Mul<Vector2<f64>> for PerBackbone<Vector2<f64>> {
    type Output = PerBackbone;

    fn mul(self, vector: Vector2<f64>) -> PerBackbone {
        self.map(|row| row.dot(&vector))
    }
}

/// A matrix of rows times a matrix.
impl Mul<Matrix2<f64>> for PerBackbone<Vector2<f64>> {
    type Output = Self;

    fn mul(self, matrix: Matrix2<f64>) -> Self {
        self.map(|row| matrix.tr_mul(&row))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_computes_as_matrices_of_any_size_do(
            count in BACKBONES, numbers in proptest::collection::vec(-9.0..9.0f64, 32), v in proptest::array::uniform2(-9.0..9.0f64)
        ) {
            let q = PerBackbone::from_fn(count, |i| Vector2::new(numbers[2 * i], numbers[2 * i + 1]));
            let x = PerBackbone::from_fn(count, |i| numbers[16 + i]);
            let matrix = DMatrix::from_fn(count, 2, |i, axis| q[i][axis]);
            let vector = DVector::from_column_slice(&x);
            let v = Vector2::from(v);
            let square = Matrix2::new(1.0, v.x, -v.y, 0.5);
            prop_assert!((DVector::from_column_slice(&(q * v)) - &matrix * v).norm() < 1e-9);
            prop_assert!((q.tr_mul(&x) - matrix.transpose() * &vector).norm() < 1e-9);
            prop_assert!((q.cross_gram(&q) - matrix.transpose() * &matrix).norm() < 1e-9);
            prop_assert!(((q * square) * v - q * (square * v)).norm() < 1e-9);
            prop_assert!((q.norm() - matrix.norm()).abs() < 1e-9);
            prop_assert_eq!((x.len(), x.amax()), (count, vector.amax()));
            prop_assert!((x.mean() - vector.mean()).abs() < 1e-12 && (x.norm() - vector.norm()).abs() < 1e-9);
            prop_assert!(((x * 2.0 - x / 2.0 + -x).add_scalar(1.0) - x.map(|x| 0.5 * x + 1.0)).norm() < 1e-9);
            prop_assert_eq!(PerBackbone::from_columns([q.column(0), q.column(1)]), q);
        }
    }

    #[test]
    fn a_list_that_is_too_long_is_none() {
        assert_eq!(PerBackbone::of(&[1.0; 8]).unwrap().len(), 8);
        assert!(PerBackbone::of(&[1.0; 9]).is_none());
        let four = PerBackbone::from([1.0, 2.0, -0.5, 0.0]);
        assert_eq!(serde_json::to_string(&four).unwrap(), "[1.0,2.0,-0.5,0.0]");
        assert_eq!(serde_json::from_str::<PerBackbone>("[1,2,-0.5,0]").unwrap(), four);
        assert!(serde_json::from_str::<PerBackbone>("[1,2,3,4,5,6,7,8,9]").is_err());
    }
}
