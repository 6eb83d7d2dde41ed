use super::error::{OutputError, on_root};
use super::folder::explain;
use crate::comm::Comm;
use std::io::{ErrorKind, Write};
use std::path::Path;

/// Prints a result on rank 0. A reader that has gone away, as in `jamhpc init | head`, is no error. Collective.
pub fn print(comm: &Comm, text: &str) -> Result<(), OutputError> {
    let printed = on_root(comm, || {
        let mut stdout = std::io::stdout().lock();
        match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
            Err(e) if e.kind() != ErrorKind::BrokenPipe => Err(explain(&e)),
            _ => Ok(()),
        }
    });
    printed.map_err(|reason| OutputError::write(Path::new("to the standard output"), reason))
}
