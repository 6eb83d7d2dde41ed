//! Jammed packings of soft and deformable particles in two dimensions.

pub mod analysis;
pub mod cli;
pub mod comm;
pub mod commands;
pub mod decomposition;
pub mod engine;
pub mod exchange;
pub mod failure;
pub mod frames;
pub mod geometry;
pub mod lanes;
pub mod minimize;
pub mod model;
pub mod neighbor;
pub mod observe;
pub mod output;
pub mod particles;
pub mod protocol;
pub mod run;
pub mod scene;
pub mod statistics;
pub mod stiffness;
pub mod study;
pub mod threads;
pub mod validate;
