//! Parse, dispatch, exit code.

use jamhpc::comm::Session;
use jamhpc::{cli, commands};
use std::process::ExitCode;

fn main() -> ExitCode {
    let session = Session::start();
    // everything that holds a communicator or a file is gone when this returns; only then may MPI end
    let code = cli::parse(&session.world()).map_or_else(|code| code, |cli| commands::dispatch(&session, cli));
    drop(session);
    ExitCode::from(code)
}
