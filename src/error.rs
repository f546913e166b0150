//! The library's errors.
//!
//! Every variant carries what a reader, or a program, needs to act: the file, the line or frame, the offending value, what
//! was expected and what to do about it. The types here hold plain values, so that every other module can use them.

use std::path::{Path, PathBuf};

/// What went wrong, where, and what to do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused a file or folder.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The verb that failed: "read", "write", "create" …
        action: &'static str,
        /// The system's own words.
        source: std::io::Error,
    },
    /// A file was read, but something in it is not as it must be.
    #[error("{}{}: {message}", path.display(), line.map(|l| format!(":{l}")).unwrap_or_default())]
    Content {
        /// The file.
        path: PathBuf,
        /// The line, counted from 1, where one can be named.
        line: Option<u64>,
        /// What was found, what was expected, what to do.
        message: String,
    },
    /// A result that cannot be written in its file's format, such as a number that JSON does not have.
    #[error("cannot write {what}: {message}")]
    Encode {
        /// What was to be written.
        what: &'static str,
        /// The format's own words.
        message: String,
    },
    /// The rig could not be calibrated from the straight picture.
    #[error("{}rig calibration: {source}", path.as_ref().map(|path| format!("{}: ", path.display())).unwrap_or_default())]
    Rig {
        /// The straight picture, where it is a file.
        path: Option<PathBuf>,
        /// What was not found and what to change.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The caller asked for something that cannot be.
    #[error(transparent)]
    Argument(#[from] ArgumentError),
    /// The model has no answer there.
    #[error(transparent)]
    NoSolution(#[from] NoSolution),
    /// The data do not say what they were asked for.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A scene that cannot be drawn.
    #[error("{0}")]
    Scene(&'static str),
    /// Something outside the program, a stream, a server's address or a terminal, cannot be used.
    #[error("{what}: {message}")]
    Unavailable {
        /// What it is.
        what: String,
        /// Why it cannot be used.
        message: String,
    },
    /// The program that called for the work ended it.
    #[error("the work was ended before it was done")]
    Ended,
    /// The work needs OpenCV and this build has none.
    #[error("{what} needs OpenCV, which this build leaves out; build with the feature `opencv`")]
    NoOpenCv {
        /// What was asked for.
        what: String,
    },
    /// OpenCV answered with an error.
    #[error("OpenCV: {action}: {message}")]
    OpenCv {
        /// What was being done.
        action: String,
        /// OpenCV's own words.
        message: String,
    },
}

/// A result, with the library's error unless another is named.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// An error about the content of a file, with no line to name.
    pub fn content(path: &Path, message: impl Into<String>) -> Self {
        Self::Content { path: path.to_owned(), line: None, message: message.into() }
    }

    /// An error about one line (counted from 1) of a file.
    pub fn at_line(path: &Path, line: u64, message: impl Into<String>) -> Self {
        Self::Content { path: path.to_owned(), line: Some(line), message: message.into() }
    }

    /// An error of the operating system about a path.
    pub fn io(path: &Path, action: &'static str) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, action, source }
    }

    /// An error of a format that a result is to be written in.
    pub fn encode<E: std::fmt::Display>(what: &'static str) -> impl FnOnce(E) -> Self {
        move |message| Self::Encode { what, message: message.to_string() }
    }

    /// An error about the straight picture that a rig is calibrated from.
    pub fn rig<E: Into<Box<dyn std::error::Error + Send + Sync>>>(path: &Path) -> impl FnOnce(E) -> Self {
        let path = path.to_owned();
        move |source| Self::Rig { path: Some(path), source: source.into() }
    }
}

impl ArgumentError {
    /// A number outside its range.
    pub fn out_of_range(
        quantity: impl Into<String>,
        value: f64,
        unit: &'static str,
        expected: impl Into<String>,
    ) -> Self {
        Self::OutOfRange { quantity: quantity.into(), value, unit, expected: expected.into() }
    }
}

/// Something that a caller asked for and that cannot be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ArgumentError {
    /// A number outside its range.
    #[error("{quantity} is {value}{unit}, expected {expected}")]
    OutOfRange {
        /// What the number is.
        quantity: String,
        /// The number.
        value: f64,
        /// Its unit as it is written behind it, with a space where one belongs.
        unit: &'static str,
        /// The range, in words.
        expected: String,
    },
    /// A text that is not of the form it must have.
    #[error("{what} {text:?}: expected {expected}")]
    Syntax {
        /// What it should be.
        what: &'static str,
        /// The text.
        text: String,
        /// The form.
        expected: &'static str,
    },
    /// A name that is not known.
    #[error("{what} {name:?} is not known to this version; it knows {}", known.join(", "))]
    Unknown {
        /// What is named.
        what: String,
        /// The name.
        name: String,
        /// The names that are known.
        known: Vec<String>,
    },
    /// A parameter of an effect that was not given.
    #[error("effect {effect}: {parameter} is missing; it takes {}", takes.join(", "))]
    MissingParameter {
        /// The effect's name.
        effect: String,
        /// The parameter's name.
        parameter: &'static str,
        /// All parameters of the effect.
        takes: Vec<&'static str>,
    },
    /// A parameter that an effect does not have.
    #[error("effect {effect} has no parameter {parameter:?}; it has {}", takes.join(", "))]
    UnknownParameter {
        /// The effect's name.
        effect: String,
        /// The parameter's name.
        parameter: String,
        /// All parameters of the effect.
        takes: Vec<&'static str>,
    },
    /// Numbers that are no camera's.
    #[error("camera: {0}")]
    Camera(String),
    /// Constants of which no robot can be made.
    #[error("robot: {0}")]
    Robot(String),
    /// A user's own effect whose definition has a fault.
    #[error("effect {effect}: {why}")]
    Formula {
        /// The effect's name.
        effect: String,
        /// What is wrong, and where.
        why: String,
    },
    /// A grid of angles that no table can be made on.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// Force limits that are not finite or not in order.
    #[error("force limits {pull_n} and {push_n} N: expected the largest pull (negative), then the largest push")]
    ForceLimits {
        /// The limit of the pull, N.
        pull_n: f64,
        /// The limit of the push, N.
        push_n: f64,
    },
    /// A trajectory without a single pose.
    #[error("a trajectory without poses; give sweeps with poses, or a round")]
    NoPoses,
    /// A board of corners too few to tell a lens from, or of no size.
    #[error(
        "a board of {columns}×{rows} inner corners, {square_mm} mm apart: at least 3×3 are needed, at a positive distance"
    )]
    Board {
        /// Inner corners along a row.
        columns: usize,
        /// Inner corners along a column.
        rows: usize,
        /// Side of a square, mm.
        square_mm: f64,
    },
    /// A model without an estimate of η and λ where one is needed.
    #[error("{what} can be determined only if η and λ are known; give a model that `run` or `estimate` wrote")]
    NoEstimate {
        /// What cannot be told.
        what: &'static str,
    },
    /// A model without friction where the friction is what tells.
    #[error("friction.mu = {mu}: the angle of a line without friction cannot be found")]
    NoFriction {
        /// The coefficient of friction.
        mu: f64,
    },
    /// A server that other machines can reach, without a token.
    #[error(
        "a server at {address} can be reached from other machines: it needs a token, or an address of this machine alone (127.0.0.1)"
    )]
    OpenToAll {
        /// The address to listen at.
        address: std::net::SocketAddr,
    },
    /// A token that can be guessed, or that a header cannot hold.
    #[error("the token must be {least} or more letters and digits")]
    WeakToken {
        /// The fewest letters and digits.
        least: usize,
    },
}

/// A grid of angles that no table can be made on; grids are shown as they are written, start:stop:step in degrees.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GridError {
    /// A number that is not finite, or a step that is not above 0.
    #[error("grid {0}: expected finite degrees and a step above 0")]
    NotFinite(String),
    /// The stop lies below the start.
    #[error("grid {0}: the stop lies below the start; swap them")]
    Descending(String),
    /// A bend outside the workspace.
    #[error("grid of θ {grid}: the model answers for 0 to {most_deg:.0}°; keep start and stop within")]
    Theta {
        /// The grid of θ.
        grid: String,
        /// The largest bend that the model answers for, degrees.
        most_deg: f64,
    },
    /// An azimuth beyond a full turn.
    #[error("grid of δ {0}: expected −360 to 360°; keep start and stop within")]
    Delta(String),
    /// More poses than a table may have.
    #[error("grids {theta} and {delta} make {poses} poses, expected {most} at most")]
    TooManyPoses {
        /// The grid of θ.
        theta: String,
        /// The grid of δ.
        delta: String,
        /// How many poses they make.
        poses: usize,
        /// How many there may be.
        most: usize,
    },
    /// Too few angles to interpolate between.
    #[error("a C header needs four angles of θ and four of δ at least, {theta} and {delta} were given")]
    TooFewAngles {
        /// How many bends there are.
        theta: usize,
        /// How many azimuths there are.
        delta: usize,
    },
    /// Angles too far apart to interpolate between.
    #[error(
        "between the poses of this grid the C header's lookup would be up to {error_deg:.2}° of bend off the model, expected at most {most_deg}°; \
         take smaller steps, such as -165:180:15 of δ and 5 of θ"
    )]
    TooCoarse {
        /// The largest error between two poses, degrees of bend.
        error_deg: f64,
        /// The largest that is allowed, degrees.
        most_deg: f64,
    },
    /// Commands that jump from one pose to the next, so that nothing can be interpolated between them.
    #[error(
        "the model's {effects} makes commands jump where a backbone does not move (by {error_deg:.2}° of bend between poses of this grid), and a C \
         header interpolates between them; command from compensation.csv, or from `invert` for each pose"
    )]
    Jumps {
        /// The effects that remember which way a backbone moved.
        effects: String,
        /// The largest error between two poses, degrees of bend.
        error_deg: f64,
    },
    /// Azimuths that do not go once round.
    #[error("a C header needs δ once round in even steps; {grid} gives {angles} angles, try -165:180:15")]
    NotRound {
        /// The grid of δ.
        grid: String,
        /// How many azimuths it has.
        angles: usize,
    },
}

/// The model has no answer there.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NoSolution {
    /// A pose outside the model's workspace.
    #[error(
        "θ = {theta_deg}°, δ = {delta_deg}° is outside the workspace, expected θ from 0 to {most_deg:.0}° and δ from −360° to 360°"
    )]
    OutsideWorkspace {
        /// The bend, degrees.
        theta_deg: f64,
        /// The azimuth, degrees.
        delta_deg: f64,
        /// The largest bend that the model answers for, degrees.
        most_deg: f64,
    },
    /// Displacements that bend the snake beyond the model's workspace.
    #[error(
        "q̃ = ({}) mm bends the snake beyond {most_deg:.0}°, where the model does not hold; command less, or check the \
         encoders' units and zero",
        q_mm.iter().map(|q| format!("{q:.3}")).collect::<Vec<_>>().join(", ")
    )]
    BeyondWorkspace {
        /// q̃, mm.
        q_mm: Vec<f64>,
        /// The largest bend that the model answers for, degrees.
        most_deg: f64,
    },
    /// A derivative that cannot be inverted.
    #[error(
        "the model has no unique bend at θ = {theta_deg:.2}°: η = {eta} makes its derivative singular; check the estimate"
    )]
    Singular {
        /// The bend, degrees.
        theta_deg: f64,
        /// η of the model.
        eta: f64,
    },
    /// The azimuth of a straight snake.
    #[error("δ is not defined at θ = 0; use the bend vector there")]
    Straight,
}

/// The data do not say what they were asked for.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DataError {
    /// Too few weighings to fit a line and judge it.
    #[error("friction calibration: {found} weighings, expected at least {needed} to fit a line and judge it")]
    TooFewWeighings {
        /// How many there are.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// Weighings whose line no friction explains.
    #[error(
        "friction calibration: the weighings give the line τ̃ = {slope:.4} τ {intercept_g:+.1} g, expected a line \
         that does not start below zero and whose slope is 1 (no friction) to {most_slope:.3} (μ = 1); check the two columns of forces and their unit"
    )]
    NotFriction {
        /// Its slope.
        slope: f64,
        /// Where it meets τ = 0, g.
        intercept_g: f64,
        /// The slope that goes with the largest friction coefficient.
        most_slope: f64,
    },
    /// Too few samples to tell an effect from noise.
    #[error(
        "{found} usable samples, and {needed} at least are needed to tell an effect from noise; measure more poses"
    )]
    TooFewSamples {
        /// How many there are.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// Encoders that stand still.
    #[error("the encoders hardly move (less than {least_mm} mm); lead the snake along sweeps")]
    Still {
        /// What one of them at least must move, mm.
        least_mm: f64,
    },
    /// Not one measurement that can be used.
    #[error("no measurement could be used; angles with status ok and encoder readings are needed")]
    NoMeasurement,
    /// An estimate that is not there yet.
    #[error("η and λ are not known yet: no table was written")]
    NoEstimateYet,
    /// Too few pictures of the whole board.
    #[error(
        "{found} pictures show the whole board, at least {needed} are needed{}",
        skipped.iter().map(|(path, why)| format!("\n  {}: {why}", path.display())).collect::<String>()
    )]
    TooFewBoards {
        /// How many show it.
        found: usize,
        /// How many must.
        needed: usize,
        /// Those that do not, and why.
        skipped: Vec<(PathBuf, String)>,
    },
    /// Boards that do not tell the lens.
    #[error("the boards leave the lens undetermined; tilt the board more, and differently")]
    LensUndetermined,
}
