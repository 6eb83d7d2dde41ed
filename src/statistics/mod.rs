//! Averages, their errors, and fits.
