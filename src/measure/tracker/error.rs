//! Why poses of a tracker cannot be used, and what to do.

/// Why poses of a tracker cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TrackerError {
    /// Too few poses.
    #[error("{found} poses with a position, and {needed} at least are needed to find the base; record a sweep")]
    TooFew {
        /// How many there are.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// The straight pose is not there.
    #[error(
        "straight = {index}: there is no pose with a position of this index; name one in which the snake is unbent"
    )]
    NoStraight {
        /// The index that was named.
        index: u64,
    },
    /// A stated base that is not where a base can be.
    #[error(
        "base_mm is {found_mm:.1} mm from the straight tip, and the snake is {length_mm} mm long; check that it is in mm and in the frame \
         of the poses"
    )]
    BaseElsewhere {
        /// Its distance from the straight tip.
        found_mm: f64,
        /// The snake's length.
        length_mm: f64,
    },
    /// Positions that look as if in metres.
    #[error(
        "the tip is at most {spread_mm:.4} mm from where it is straight, and the snake is {length_mm} mm long: the positions look as if \
         in metres; write them in mm"
    )]
    Metres {
        /// How far nine poses of ten lie from the straight one at most, as the file has it.
        spread_mm: f64,
        /// The snake's length.
        length_mm: f64,
    },
    /// Positions that no tip of this snake can take.
    #[error(
        "one pose in ten is more than {spread_mm:.1} mm from where the tip is straight, and the snake is {length_mm} mm long; check the \
         unit, that it is this snake's tip, and that the poses are in one frame"
    )]
    TooFar {
        /// How far nine poses of ten lie from the straight one at most.
        spread_mm: f64,
        /// The snake's length.
        length_mm: f64,
    },
    /// A tip that stands still.
    #[error(
        "the tip stays within {spread_mm:.3} mm of where it is straight, on a snake of {length_mm} mm; lead it along sweeps to several \
         sides"
    )]
    Still {
        /// How far nine poses of ten lie from the straight one at most.
        spread_mm: f64,
        /// The snake's length.
        length_mm: f64,
    },
    /// A base that the poses leave open.
    #[error("the poses leave the base's axis open (σ {sigma_deg:.1}°); bend the snake further and to several sides")]
    Undetermined {
        /// Standard deviation of the axis' direction, degrees.
        sigma_deg: f64,
    },
    /// Positions and orientations that belong to frames of different handedness.
    #[error(
        "positions and orientations contradict each other unless the {axis} axis of the positions is turned round; change its sign"
    )]
    Flipped {
        /// The axis.
        axis: &'static str,
    },
    /// Poses that no snake like this one takes.
    #[error(
        "positions scatter by {scatter_mm:.1} mm about the arcs of a snake of {length_mm} mm, orientations by {scatter_deg:.0}°; check the \
         robot's length, that all poses are in one frame that stays with the base, that the sensor is in the middle of the tip (else give \
         base_mm), and the order of quaternions (qw,qx,qy,qz), which turn the sensor's axes into that frame"
    )]
    NoArcs {
        /// Scatter of the positions.
        scatter_mm: f64,
        /// Scatter of the orientations; 0 where there are none.
        scatter_deg: f64,
        /// The snake's length.
        length_mm: f64,
    },
    /// Bends that go round the other way than the encoders say.
    #[error(
        "the tip goes round the other way than the encoders say: an axis of the tracker is flipped (its frame is left-handed), or two \
         columns of the log are swapped; change the sign of one axis, or say so in [wiring]. A sensor that is not in the middle of the tip \
         can look like that: give base_mm"
    )]
    Mirrored,
    /// An azimuth that nothing tells.
    #[error(
        "nothing tells which way the base's x axis points: give `encoders` that move, or `delta_offset_deg`, the azimuth of the tracker's x \
         axis in the base's frame"
    )]
    NoAzimuth,
    /// A stated azimuth of an axis that has none.
    #[error(
        "delta_offset_deg: the tracker's x axis lies along the straight snake and has no azimuth; leave it to the encoders"
    )]
    AxisAlongSnake,
}
