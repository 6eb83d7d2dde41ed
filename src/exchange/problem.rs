use crate::engine::EngineError;

/// Why a configuration could not be used. All ranks get the same value.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExchangeError {
    #[error("{origin}: {problem}")]
    Input { origin: String, problem: Problem },
    #[error("{origin}: {source}")]
    Engine { origin: String, source: EngineError },
}

/// What is wrong with the text of a configuration, and what to do about it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Problem {
    #[error("the file is empty: give one JSON object, such as {}", EXAMPLE)]
    Empty,
    #[error("this is not JSON: {0}. (JSON has no NaN, no infinity, no comments and no trailing commas)")]
    Syntax(String),
    #[error("`{key}` must be {expected}, but is {got}")]
    Wrong { key: String, expected: String, got: String },
    #[error("`{key}` is missing: add {expected}")]
    Missing { key: String, expected: String },
    #[error("unknown key `{key}`{hint}; accepted here: {known}")]
    UnknownKey { key: String, hint: String, known: String },
    #[error("`{key}` has {got} entries, but must have {expected}: {why}")]
    Length { key: &'static str, got: usize, expected: usize, why: &'static str },
    #[error("the vertices of particle {particle} run clockwise: list them counter-clockwise")]
    Clockwise { particle: usize },
    #[error("the outline of particle {particle} has no area: give it three vertices or more that lie on no line")]
    NoArea { particle: usize },
    #[error("the outline of particle {particle} crosses itself: crossed outlines never untangle, give it uncrossed")]
    CrossesItself { particle: usize },
    #[error(
        "vertices {edge} and {} of particle {particle} (counted from 0) are half a box or more apart: give each \
         particle whole, in one periodic image, with edges shorter than half the box",
        next
    )]
    LongEdge { particle: usize, edge: usize, next: usize },
    #[error(
        "the outlines of particles {} and {} cross, or one lies inside the other: crossed outlines never untangle, \
         move the particles apart", particles[0], particles[1]
    )]
    Crossing { particles: [u32; 2] },
}

pub(super) const EXAMPLE: &str = r#"{"model": "sp", "box": {"lx": 4.0, "ly": 4.0, "xy": 0.0}, "epsilon": 1.0, "diameters": [1.0, 1.0], "positions": [[1.0, 1.0], [1.9, 1.0]]}"#;
