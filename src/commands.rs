//! What each command does. Whatever a command cannot do ends as one line on the standard error and an exit code.

use crate::analysis;
use crate::cli::{Cli, Command, LogFormat, RunOptions, Settings, Starter};
use crate::comm::{Comm, Session, tell};
use crate::costs;
use crate::exchange;
use crate::failure::{Failure, exit};
use crate::frames::{self, Frame};
use crate::minimize::{ConjugateGradient, Fire, Goal, Minimized, Newton, Report};
use crate::output::folder::{can_be_written, write_whole};
use crate::output::{self, info};
use crate::profile;
use crate::run;
use crate::scene::{self, Method, Scene};
use crate::study::{self, figures::NUMBERS, plan::Plan};
use crate::validate::{self, Effort};
use std::path::Path;

/// Does what the flags say and returns the exit code, the same on all ranks.
pub fn dispatch(session: &Session, cli: Cli) -> u8 {
    let is_root = session.world().is_root();
    let started = session.world().agree(start(&cli.settings, is_root));
    let outcome = started.and_then(|()| execute(session, &cli));
    if cli.settings.profile && !matches!(outcome, Err(Failure::Input(_))) {
        let table = costs::table(&session.world());
        if is_root {
            tell(&table);
        }
    }
    match outcome {
        Ok(()) => exit::SUCCESS,
        Err(failure) => {
            if is_root {
                tell(&format!("error: {failure}\n"));
            }
            failure.exit_code()
        }
    }
}

fn execute(session: &Session, cli: &Cli) -> Result<(), Failure> {
    let comm = session.world();
    // logs that a program reads are not to be mixed with lines for people
    let speaks = cli.settings.log_format == LogFormat::Text;
    match &cli.command {
        None => {
            let scene = read_scene(&comm, None, &cli.options)?;
            run::run(comm, &scene, cli.options.resume, speaks)
        }
        Some(Command::Run { scene, options, check }) => {
            let scene = read_scene(&comm, Some(scene), options)?;
            if *check {
                run::setup::check(comm.size(), &scene)?;
                return print(&comm, &scene.to_toml());
            }
            run::run(comm, &scene, options.resume, speaks)
        }
        Some(Command::Study { study, output, check, retry }) => {
            let plan = Plan::parse(&read_text(&comm, study)?, &study.display().to_string())
                .map_err(|e| Failure::Input(e.to_string()))?;
            for group in &plan.groups {
                run::setup::check(group.ranks, &group.scene)
                    .map_err(|e| Failure::Input(format!("{}: {}: {e}", study.display(), group.id())))?;
            }
            if *check {
                return print(&comm, &plan.summary());
            }
            let folder = output.clone().unwrap_or_else(|| study.file_stem().map_or_else(Default::default, Into::into));
            let summary = study::run(&comm, &plan, &folder, *retry, speaks)?;
            print(&comm, &summary)
        }
        Some(Command::Plot { study, figure, all }) => {
            let numbers = figure.as_ref().map_or(&NUMBERS[..], std::slice::from_ref);
            let list = comm.from_root(|| {
                let written = study::draw(study, numbers, *all)?;
                let lines: String = written.iter().skip(1).map(|path| format!("{}\n", path.display())).collect();
                Ok::<_, Failure>(lines.into_bytes())
            })?;
            print(&comm, &String::from_utf8_lossy(&list))
        }
        Some(Command::Evaluate { file, frame, with, output }) => {
            expect_to_write(&comm, output.as_deref(), Some(file))?;
            let text = read_configuration(&comm, file, *frame)?;
            let evaluation = exchange::evaluate(comm, &text, &file.display().to_string(), with)?;
            give(&session.world(), output.as_deref(), &evaluation)
        }
        Some(Command::Minimize { file, frame, output, method, force_tolerance, max_iterations }) => {
            // a relaxation may go on in place, but never in that of results
            expect_to_write(&comm, Some(output), Some(file.as_path()).filter(|file| is_hdf5(file)))?;
            let text = read_configuration(&comm, file, *frame)?;
            let goal = Goal { force_tolerance: *force_tolerance, max_iterations: *max_iterations };
            let origin = file.display().to_string();
            let (relaxed, outcome) = match method {
                Method::Fire => exchange::minimize(comm, &text, &origin, &Fire, &goal)?,
                Method::Cg => exchange::minimize(comm, &text, &origin, &ConjugateGradient, &goal)?,
                Method::Newton => exchange::minimize(comm, &text, &origin, &Newton, &goal)?,
            };
            give(&session.world(), Some(output), &relaxed)?;
            report(outcome, &goal, output)
        }
        Some(Command::Analyze { file, frame, all, output }) => {
            expect_to_write(&comm, output.as_deref(), Some(file))?;
            let text = text_of_configuration(&comm, file)?;
            if text.is_some() && (*all || frame.is_some()) {
                let file = file.display();
                return Err(Failure::Input(format!(
                    "{file} is no results file and has no frames: leave --frame and --all out"
                )));
            }
            let analysis = analysis::analyze(session, file, text.as_deref(), *frame, *all)?;
            give(&comm, output.as_deref(), &analysis)
        }
        Some(Command::Check { file, frame, force_tolerance }) => {
            let text = text_of_configuration(&comm, file)?;
            print(&comm, &analysis::check(session, file, text.as_deref(), *frame, *force_tolerance)?)
        }
        Some(Command::Render { file, frame, color_by, part, output }) => {
            let ending = output.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
            if !["svg", "png"].contains(&ending.as_str()) {
                return Err(Failure::Input(format!("cannot draw {}: name it .svg or .png", output.display())));
            }
            if let Some(part) = part.filter(|part| !(*part > 0.0 && *part <= 1.0)) {
                return Err(Failure::Input(format!("--part {part}: it must be above 0 and not above 1, such as 0.2")));
            }
            expect_to_write(&comm, Some(output), Some(file))?;
            frames::render(comm, file, *frame, *color_by, *part, output)
        }
        Some(Command::Info { file }) => {
            let text = comm.from_root(|| Ok::<_, Failure>(info(file)?.into_bytes()))?;
            print(&comm, &String::from_utf8_lossy(&text))
        }
        Some(Command::Validate { long }) => check(session, if *long { Effort::Long } else { Effort::Quick }),
        Some(Command::Init { model, output }) => {
            let text = match model {
                Starter::Sp => scene::SP_STARTER,
                Starter::Dp => scene::DP_STARTER,
                Starter::Study => study::plan::STARTER,
            };
            match to_write(output.as_deref()) {
                Some(file) => write_new(&comm, file, text),
                None => print(&comm, text),
            }
        }
    }
}

/// Runs the exact checks, one line each as it comes; those that fail are named at the end.
fn check(session: &Session, effort: Effort) -> Result<(), Failure> {
    let comm = session.world();
    print(&comm, &validate::header())?;
    let mut printed = Ok(());
    let checks = validate::run(&|| session.world(), effort, |check| {
        printed = printed.clone().and(print(&comm, &validate::line(check)));
    })?;
    printed?;
    let failed: Vec<&str> = checks.iter().filter(|check| !check.passes()).map(|check| check.name.as_str()).collect();
    if failed.is_empty() {
        return print(&comm, &format!("all {} checks pass\n", checks.len()));
    }
    Err(Failure::Other(format!("{} of {} checks fail: {}", failed.len(), checks.len(), failed.join("; "))))
}

/// What a minimisation came to; one that did not converge is a failure, though its state has been written.
fn report(outcome: Minimized, goal: &Goal, output: &Path) -> Result<(), Failure> {
    let Report { iterations, max_force, .. } = outcome.report();
    if outcome.is_converged() {
        return Ok(());
    }
    Err(Failure::NotConverged(format!(
        "not converged: max|F| = {max_force:.3e} is above {:e} after {iterations} iterations. The state so far is in \
         {}, marked as not converged: go on from it, raise --max-iterations or loosen --force-tolerance",
        goal.force_tolerance,
        to_write(Some(output)).map_or("what is printed".into(), |file| file.display().to_string())
    )))
}

/// Threads and logs, before any work.
fn start(settings: &Settings, is_root: bool) -> Result<(), Failure> {
    // the calling thread is one of them, so that a single thread starts no other
    rayon::ThreadPoolBuilder::new()
        .num_threads(settings.threads as usize)
        .use_current_thread()
        .build_global()
        .map_err(|e| Failure::Other(format!("cannot start {} threads: {e}", settings.threads)))?;
    if is_root {
        start_logs(settings);
    }
    if settings.profile {
        profile::start();
    }
    Ok(())
}

fn start_logs(settings: &Settings) {
    let json = settings.log_format == LogFormat::Json;
    let usual = if json { "info" } else { "warn" };
    let filter = settings.log_level.clone().unwrap_or_else(|| usual.into());
    let logs =
        tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).log_internal_errors(false);
    if json {
        logs.json().init();
    } else {
        logs.with_ansi(std::io::IsTerminal::is_terminal(&std::io::stderr())).init();
    }
}

/// The scene of a file, or the built-in one, with the changes of the command line; the same on all ranks.
fn read_scene(comm: &Comm, file: Option<&Path>, options: &RunOptions) -> Result<Scene, Failure> {
    let (text, origin) = match file {
        None => (scene::DEFAULT.to_string(), "the built-in scene".to_string()),
        Some(file) => (read_text(comm, file)?, file.display().to_string()),
    };
    let mut scene = Scene::parse(&text, &origin, &options.set)?;
    if let Some(directory) = &options.output {
        scene.output.directory = directory.to_string_lossy().into_owned();
    }
    Ok(scene)
}

/// The text of a file that is no results file; none of one that is.
fn text_of_configuration(comm: &Comm, file: &Path) -> Result<Option<String>, Failure> {
    let is_results = comm.from_root(|| Ok::<_, Failure>(vec![is_hdf5(file) as u8]))? == [1];
    if is_results { Ok(None) } else { read_text(comm, file).map(Some) }
}

/// A configuration in the exchange format, from such a file or from a frame of a results file.
fn read_configuration(comm: &Comm, file: &Path, frame: Frame) -> Result<String, Failure> {
    if let Some(text) = text_of_configuration(comm, file)? {
        if frame.is_some() {
            let file = file.display();
            return Err(Failure::Input(format!("--frame is for results files, and {file} is none: leave it out")));
        }
        return Ok(text);
    }
    let bytes = comm.from_root(|| {
        let configuration = frames::configuration(file, frame)?;
        serde_json::to_vec(&configuration).map_err(|e| Failure::Other(e.to_string()))
    })?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

fn is_hdf5(file: &Path) -> bool {
    let mut start = [0; 8];
    let read = std::fs::File::open(file).and_then(|mut file| std::io::Read::read_exact(&mut file, &mut start));
    read.is_ok() && start == *b"\x89HDF\r\n\x1a\n"
}

/// A text file, read by rank 0.
fn read_text(comm: &Comm, file: &Path) -> Result<String, Failure> {
    let bytes = comm.from_root(|| {
        let bytes = std::fs::read(file).map_err(|e| Failure::Input(format!("cannot read {}: {e}", file.display())))?;
        match std::str::from_utf8(&bytes) {
            Ok(_) => Ok(bytes),
            Err(_) => Err(Failure::Input(format!("{} is not a text file (UTF-8)", file.display()))),
        }
    })?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// Prints on rank 0.
fn print(comm: &Comm, text: &str) -> Result<(), Failure> {
    Ok(output::print(comm, text)?)
}

/// The file to write, if it is one: `-` is the standard output.
fn to_write(file: Option<&Path>) -> Option<&Path> {
    file.filter(|file| *file != Path::new("-"))
}

/// Writes a file on rank 0, whole or not at all; prints where none is asked for.
fn give(comm: &Comm, file: Option<&Path>, text: &str) -> Result<(), Failure> {
    let Some(file) = to_write(file) else { return print(comm, text) };
    comm.from_root(|| {
        write_whole(file, text.as_bytes())?;
        Ok::<_, Failure>(Vec::new())
    })?;
    Ok(())
}

/// Refuses a file for results that cannot be written, or is the one that is to be kept, before they are computed.
fn expect_to_write(comm: &Comm, file: Option<&Path>, keep: Option<&Path>) -> Result<(), Failure> {
    let Some(file) = to_write(file) else { return Ok(()) };
    comm.from_root(|| {
        let [to, from] = [Some(file), keep].map(|file| file.and_then(|file| std::fs::canonicalize(file).ok()));
        if to.is_some() && to == from {
            return Err(Failure::Input(format!("{} is what is read: give -o another name", file.display())));
        }
        can_be_written(file).map(|()| Vec::new()).map_err(|e| Failure::Input(e.to_string()))
    })?;
    Ok(())
}

/// Writes a file that must not exist yet.
fn write_new(comm: &Comm, file: &Path, text: &str) -> Result<(), Failure> {
    comm.from_root(|| {
        let write = || std::io::Write::write_all(&mut std::fs::File::create_new(file)?, text.as_bytes());
        write().map(|()| Vec::new()).map_err(|e| match e.kind() {
            std::io::ErrorKind::AlreadyExists => {
                Failure::Input(format!("{} exists already: remove it or choose another name", file.display()))
            }
            _ => Failure::Input(format!("cannot write {}: {e}", file.display())),
        })
    })?;
    Ok(())
}
