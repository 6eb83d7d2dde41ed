//! Lists cases as `name::npK` (K ranks) or `name::npKtT` (and T threads each) and starts each as `mpirun -n K` of this
//! very executable, the case named in the environment. The process that lists and judges never initialises MPI.

use jamhpc::comm::{Comm, EXIT_PANIC, Session};
use libtest_mimic::{Arguments, Failed, Trial};
use std::fs;
use std::io;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, ExitCode, ExitStatus};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// Lines that describe the result of a case to the last bit; those of rank 0 count.
pub type Outcome = Vec<String>;

#[derive(Clone, Copy, PartialEq)]
pub struct Start {
    ranks: usize,
    threads: usize,
}

impl Start {
    pub const fn new(ranks: usize, threads: usize) -> Self {
        Start { ranks, threads }
    }
}

pub struct Case {
    name: &'static str,
    work: fn(Comm) -> Outcome,
    starts: Vec<Start>,
    must_abort: bool,
    /// What it gave on one rank with one thread.
    alone: OnceLock<Result<String, String>>,
}

impl Case {
    /// If `starts` begins with one rank and one thread, all others must give the same.
    pub fn new(name: &'static str, work: fn(Comm) -> Outcome, starts: &[Start]) -> Self {
        Case { name, work, starts: starts.to_vec(), must_abort: false, alone: OnceLock::new() }
    }

    /// The case succeeds when a panic on one rank has ended all.
    pub fn must_abort(self) -> Self {
        Case { must_abort: true, ..self }
    }
}

/// Protects against hangs only: ten times what the slowest case takes on two busy cores.
const LIMIT: Duration = Duration::from_secs(300);
/// "In seconds", on a machine that may be busy.
const ABORT_LIMIT: Duration = Duration::from_secs(60);

const CASE: &str = "JAMHPC_TEST_CASE";
const RESULT: &str = "JAMHPC_TEST_RESULT";

pub fn run(cases: Vec<Case>) -> ExitCode {
    if let Ok(name) = std::env::var(CASE) {
        let case = cases.iter().find(|c| c.name == name).expect("the parent names a case of this list");
        let session = Session::start();
        let comm = session.world();
        let is_root = comm.is_root();
        let outcome = (case.work)(comm);
        if is_root {
            fs::write(std::env::var(RESULT).unwrap(), outcome.join("\n")).unwrap();
        }
        return ExitCode::SUCCESS;
    }
    let mut arguments = Arguments::from_args();
    arguments.test_threads = Some(1); // the ranks of one case are enough for the machine
    // trials want 'static; the list lives as long as the process
    let cases: &'static [Case] = Vec::leak(cases);
    let mut trials = Vec::new();
    for case in cases {
        for &start in &case.starts {
            let threads = if start.threads > 1 { format!("t{}", start.threads) } else { String::new() };
            let name = format!("{}::np{}{threads}", case.name, start.ranks);
            trials.push(Trial::test(name, move || judge(case, start).map_err(Failed::from)));
        }
    }
    libtest_mimic::run(&arguments, trials).exit_code()
}

fn judge(case: &Case, start: Start) -> Result<(), String> {
    const ALONE: Start = Start::new(1, 1);
    if case.must_abort {
        return judge_abort(case, start);
    }
    if !case.starts.contains(&ALONE) {
        return result(case, start).map(|_| ());
    }
    let alone = case.alone.get_or_init(|| result(case, ALONE));
    if start == ALONE {
        return alone.clone().map(|_| ());
    }
    let alone = alone.as_ref().map_err(|_| "one rank has failed already".to_string())?;
    let here = result(case, start)?;
    if here == *alone {
        return Ok(());
    }
    let differing: String = alone
        .lines()
        .zip(here.lines())
        .filter(|(a, b)| a != b)
        .take(10)
        .map(|(a, b)| format!("  one rank: {a}\n  here:     {b}\n"))
        .collect();
    Err(format!("differs from one rank ({} and {} lines):\n{differing}", alone.lines().count(), here.lines().count()))
}

/// The lines that rank 0 returned.
fn result(case: &Case, start: Start) -> Result<String, String> {
    let run = launch(case, start, LIMIT).map_err(|e| e.to_string())?;
    match (run.status, run.result) {
        (Some(status), Some(result)) if status.success() => Ok(result),
        (Some(status), _) => Err(format!("{status}\n{}", run.output)),
        (None, _) => Err(format!("did not end within {LIMIT:?}\n{}", run.output)),
    }
}

fn judge_abort(case: &Case, start: Start) -> Result<(), String> {
    let run = launch(case, start, ABORT_LIMIT).map_err(|e| e.to_string())?;
    let Some(status) = run.status else { return Err(format!("did not end within {ABORT_LIMIT:?}\n{}", run.output)) };
    // Open MPI's launcher passes the status on; others answer with one of their own
    let told = run.output.contains("internal error on rank 1");
    if status.success() || !told || run.result.is_some() {
        return Err(format!("{status} (a panic's is {EXIT_PANIC})\n{}", run.output));
    }
    Ok(())
}

struct Run {
    /// None: it had to be killed.
    status: Option<ExitStatus>,
    /// Both streams of all ranks.
    output: String,
    result: Option<String>,
}

fn launch(case: &Case, start: Start, limit: Duration) -> io::Result<Run> {
    let dir = tempfile::tempdir()?;
    let (output, result) = (dir.path().join("output"), dir.path().join("result"));
    // files, not pipes: nobody has to read while the ranks run
    let stream = fs::File::create(&output)?;
    let launcher = std::env::var("MPIRUN").unwrap_or_else(|_| "mpirun".into());
    let mut command = Command::new(&launcher);
    command.arg("-n").arg(start.ranks.to_string()).arg(std::env::current_exe()?);
    command.env(CASE, case.name).env(RESULT, &result).env("RAYON_NUM_THREADS", start.threads.to_string());
    for (name, value) in OVERSUBSCRIPTION {
        if std::env::var_os(name).is_none() {
            command.env(name, value);
        }
    }
    command.stdin(std::process::Stdio::null()).stdout(stream.try_clone()?).stderr(stream);
    let child = command.process_group(0).spawn();
    let child = child.map_err(|e| io::Error::new(e.kind(), format!("cannot start {launcher}: {e}")))?;
    let status = wait(child, limit)?;
    let text = |path: &Path| fs::read(path).map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    Ok(Run { status, output: text(&output)?, result: text(&result).ok() })
}

/// More ranks than cores, as any user, with Open MPI; other launchers do not look at these.
const OVERSUBSCRIPTION: [(&str, &str); 5] = [
    ("OMPI_ALLOW_RUN_AS_ROOT", "1"),
    ("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1"),
    ("OMPI_MCA_rmaps_base_oversubscribe", "1"),
    ("OMPI_MCA_hwloc_base_binding_policy", "none"),
    ("OMPI_MCA_mpi_yield_when_idle", "1"),
];

/// Waits for the child; after `limit` ends it and everything it has started.
fn wait(mut child: Child, limit: Duration) -> io::Result<Option<ExitStatus>> {
    let begin = Instant::now();
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        if begin.elapsed() > limit {
            break;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    // the launcher ends its ranks when asked politely, and cannot when it is shot
    for (signal, patience) in [("-TERM", Duration::from_secs(5)), ("-KILL", Duration::ZERO)] {
        Command::new("kill").args([signal, "--", &format!("-{}", child.id())]).status()?;
        let asked = Instant::now();
        while asked.elapsed() < patience && child.try_wait()?.is_none() {
            std::thread::sleep(Duration::from_millis(50));
        }
    }
    child.wait()?;
    Ok(None)
}
