//! The parts of the body whose borders a picture shows, and points fixed to them.

use crate::robot::Curve;
use nalgebra::{Point3, Vector3};

/// Length of the holder that is modelled below the base disk, mm.
///
/// Convention: about three disk diameters. The holder is straight and does not move; a longer piece of it would add nothing that
/// tells the bend.
pub(super) const HOLDER_MM: f64 = 12.0;

/// A point fixed to the snake's body: `local` (mm) in the frame of the section at arc length `s_mm`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyPoint {
    /// Arc length of the section, mm; negative on the holder.
    pub s_mm: f64,
    /// Position in the section's frame (z along the tangent), mm.
    pub local: Vector3<f64>,
}

impl BodyPoint {
    /// Where the point is in the base frame, mm.
    pub fn in_base(&self, curve: &Curve) -> Point3<f64> {
        curve.frame_at(self.s_mm) * Point3::from(self.local)
    }
}

/// The piece of the body that a border point belongs to.
///
/// Edge errors along one piece are correlated, because its shading and its sharpness are the same all along it. Pieces are
/// therefore also the clusters of a fit's cluster-robust covariance (`Piece::cluster`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Piece {
    /// A side of the holder below the base disk: −1 or +1.
    HolderSide(i8),
    /// The base disk's upper rim.
    BaseRim,
    /// A rim of disk k (1 is next to the base; a tool counts as the disk after the last): near (false) or far (true) face.
    Rim(u8, bool),
    /// A side wall of disk k: −1 or +1.
    DiskSide(u8, i8),
    /// A side of tube i (0 is the primary) between disks k and k + 1.
    Tube(u8, i8, u8),
}

impl Piece {
    /// Whether the border is a sharp rim of a disk; otherwise it is a limb, where a curved surface turns away from the camera.
    pub(crate) fn is_rim(self) -> bool {
        matches!(self, Self::BaseRim | Self::Rim(..))
    }

    /// Whether it is the rim of a far face, turned to the tip.
    pub(crate) fn is_far(self) -> bool {
        matches!(self, Self::BaseRim | Self::Rim(_, true))
    }

    /// Whether the piece moves with the bend. The holder and the base disk do not.
    pub(crate) fn bends(self) -> bool {
        !matches!(self, Self::HolderSide(_) | Self::BaseRim)
    }

    /// The cluster of correlated edges that the piece belongs to, named by one of its pieces: all of one side of a tube, on
    /// which light falls in the same way from disk to disk, is one cluster.
    pub(crate) fn cluster(self) -> Self {
        match self {
            Self::Tube(tube, side, _) => Self::Tube(tube, side, 0),
            piece => piece,
        }
    }

    /// The number of the holder (0) or of the disk (from 1, next to the base) that the piece belongs to; `None` for tubes, which
    /// look alike all along the snake and so do not tell which part of it is seen.
    pub(crate) fn disk(self) -> Option<u8> {
        match self {
            Self::HolderSide(_) | Self::BaseRim => Some(0),
            Self::Rim(disk, _) | Self::DiskSide(disk, _) => Some(disk),
            Self::Tube(..) => None,
        }
    }
}
