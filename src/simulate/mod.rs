//! The other way round, for tests: pictures of a snake whose bend is known.

pub mod score;
