//! The command line: literal flags here, what they mean in `commands` and `run`.
//!
//! Every rank parses its own copy of the arguments; rank 0 alone speaks.

use crate::comm::{Comm, tell};
use crate::exchange::Extra;
use crate::failure::exit;
use crate::scene::{ColorBy, Method};
use crate::study::figures::NUMBERS;
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;
use tracing_subscriber::EnvFilter;

/// The flags as given.
#[derive(Debug, Parser)]
#[command(
    name = "jamhpc",
    version = VERSION,
    about = "Jammed packings of soft disks and deformable particles in two dimensions",
    long_about = LONG_ABOUT,
    after_help = EXAMPLES,
    args_conflicts_with_subcommands = true,
    disable_help_subcommand = true
)]
pub struct Cli {
    /// What to do; with no command the built-in scene runs
    #[command(subcommand)]
    pub command: Option<Command>,
    #[command(flatten)]
    pub options: RunOptions,
    #[command(flatten)]
    pub settings: Settings,
}

const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), " (", env!("JAMHPC_GIT_HASH"), ")");

const LONG_ABOUT: &str = "\
Jammed packings of soft disks and deformable particles in two dimensions.

Without a command the built-in scene runs: 64 deformable particles, compressed to their jamming onset and on to a \
packing fraction of 0.95. Start any command under mpirun to share the work; results are the same bits on any number \
of ranks and threads.";

const EXAMPLES: &str = "\
Examples:
  jamhpc                                        the built-in scene, results in jamhpc-out/
  mpirun -n 2 jamhpc -o look                    the same on two ranks, results in look/
  jamhpc init sp -o scene.toml                  a commented scene of soft disks to change
  jamhpc run scene.toml --check                 is it valid? what are its values, defaults included?
  mpirun -n 4 jamhpc run scene.toml --set n_particles=1024 --set seed=7 -o seed7
  jamhpc run scene.toml --resume                go on with a run that was killed, on any number of ranks
  jamhpc info jamhpc-out/results.h5             what is in a results file
  jamhpc render FILE.h5 --frame 3 --color-by pressure -o frame3.png
  jamhpc evaluate FILE.json                     energy, forces, stress, contacts of one configuration
  jamhpc analyze FILE.h5 --all -o numbers.csv   every number of every frame, measured again
  jamhpc check FILE.h5                          is every frame relaxed, uncrossed, and what it says it is?
  jamhpc validate                               is this build right? exact checks, some seconds

Exit codes: 0 done, 2 bad input, 3 not converged, no onset, or a study without any sample, 1 other failures, 85 interrupted by a
signal (--resume goes on), 70 internal error.";

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run a scene: onset search, compression, results file, picture, plot and table
    Run {
        /// The scene, a TOML file
        scene: PathBuf,
        #[command(flatten)]
        options: RunOptions,
        /// Only validate the scene, and that its box fits these ranks: print it whole, defaults included, and stop
        #[arg(long, visible_alias = "dry-run")]
        check: bool,
    },
    /// Make the packings of a study that are still missing, then its report, tables and figures
    Study {
        /// The study, a TOML file
        study: PathBuf,
        /// Folder of the results, made if absent; named after the study if not given
        #[arg(short, long, value_name = "DIR")]
        output: Option<PathBuf>,
        /// Only validate: print which packings are asked for, and stop
        #[arg(long, visible_alias = "dry-run")]
        check: bool,
        /// Try packings again that did not converge before
        #[arg(long)]
        retry: bool,
    },
    /// Draw the figures of a study, as SVG and PNG into its folder
    #[command(group = clap::ArgGroup::new("which").required(true))]
    Plot {
        /// The folder of a study
        study: PathBuf,
        /// A figure by its number in the paper: 2, 3, 4, 5, 6, 7, 9 or 10
        #[arg(long, value_name = "N", group = "which", value_parser = figure_number)]
        figure: Option<u8>,
        /// All figures, the report (report.html) and every fit (findings.csv)
        #[arg(long, group = "which")]
        all: bool,
    },
    /// Energy, forces, stress and observables of a configuration, as JSON
    Evaluate {
        /// A configuration in JSON, or one of our results files
        file: PathBuf,
        /// Which frame of a results file; the last one if not given
        #[arg(long, value_name = "K")]
        frame: Option<usize>,
        /// What to add, separated by commas
        #[arg(long, value_enum, value_delimiter = ',', value_name = "LIST")]
        with: Vec<Extra>,
        /// Where to write; the terminal if not given, or `-`
        #[arg(short, long, value_name = "OUT")]
        output: Option<PathBuf>,
    },
    /// Relax a configuration to force balance, JSON to JSON
    Minimize {
        /// A configuration in JSON, or one of our results files
        file: PathBuf,
        /// Which frame of a results file; the last one if not given
        #[arg(long, value_name = "K")]
        frame: Option<usize>,
        /// Where to write the relaxed configuration; `-` is the terminal
        #[arg(short, long, value_name = "OUT")]
        output: PathBuf,
        /// Minimiser: inertial relaxation, conjugate gradients, or Newton's method, which is fastest for deformable
        /// particles
        #[arg(long, value_enum, default_value_t = Method::Newton)]
        method: Method,
        /// Relaxed when no force is above this, in the units of the configuration
        #[arg(long, value_name = "F", default_value = "1e-9", value_parser = positive)]
        force_tolerance: f64,
        /// Give up after this many iterations
        #[arg(long, value_name = "N", default_value_t = 1_000_000, value_parser = clap::value_parser!(u64).range(1..))]
        max_iterations: u64,
    },
    /// Measure a stored state again: every observable by name
    Analyze {
        /// A results file of a run, or a configuration in JSON
        file: PathBuf,
        /// Which frame; the last one if not given
        #[arg(long, value_name = "K")]
        frame: Option<usize>,
        /// All frames, as a table (CSV)
        #[arg(long, conflicts_with = "frame")]
        all: bool,
        /// Where to write; the terminal if not given, or `-`
        #[arg(short, long, value_name = "OUT")]
        output: Option<PathBuf>,
    },
    /// Is a stored state valid? Force balance, stresses, crossings, contacts, and that its numbers are its own
    Check {
        /// A results file of a run, or a configuration in JSON
        file: PathBuf,
        /// Which frame; all of them if not given
        #[arg(long, value_name = "K")]
        frame: Option<usize>,
        /// Largest force of a relaxed state; that of the scene if not given, 1e-8 for a configuration
        #[arg(long, value_name = "F", value_parser = positive)]
        force_tolerance: Option<f64>,
    },
    /// Draw one frame of a results file
    Render {
        /// A results file of a run
        file: PathBuf,
        /// Which frame; the last one if not given
        #[arg(long, value_name = "K")]
        frame: Option<usize>,
        /// What colours the particles
        #[arg(long, value_enum, default_value_t = ColorBy::Z)]
        color_by: ColorBy,
        /// Show only this part of either edge of the box, such as 0.2 [default: 1, less for more than 200000 particles]
        #[arg(long)]
        part: Option<f64>,
        /// The picture; the ending .svg or .png decides its format
        #[arg(short, long, value_name = "PICTURE")]
        output: PathBuf,
    },
    /// What a results file holds
    Info {
        /// A results file of a run
        file: PathBuf,
    },
    /// Check the program against exact formulas and print what came out; fails if a check does
    Validate {
        /// More and finer checks, and means over many packings: about eight minutes on two cores
        #[arg(long)]
        long: bool,
    },
    /// Print a commented scene with every key, to start from
    Init {
        /// A scene of soft disks (sp) or of deformable particles (dp), or a study of many packings
        #[arg(value_enum, default_value_t = Starter::Dp)]
        model: Starter,
        /// Write it to this file, which must not exist yet, instead of the standard output (-)
        #[arg(short, long, value_name = "SCENE.toml")]
        output: Option<PathBuf>,
    },
}

/// Options of a run, with or without a scene file.
#[derive(Debug, Default, Args)]
pub struct RunOptions {
    /// Folder of the results, made if absent [default: output.directory of the scene]
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
    /// Go on with a run that was interrupted or killed, from its last checkpoint, to the same bits
    #[arg(long)]
    pub resume: bool,
    /// Change one key of the scene, such as --set onset.step=0.001; may be repeated
    #[arg(long, value_name = "PATH.TO.KEY=VALUE")]
    pub set: Vec<String>,
}

/// What holds for every command.
#[derive(Debug, Args)]
pub struct Settings {
    /// Threads of each rank
    #[arg(long, global = true, value_name = "N", env = "RAYON_NUM_THREADS", default_value_t = 1,
          value_parser = n_threads)]
    pub threads: u16,
    /// Print at the end where the time went and what the ranks sent each other
    #[arg(long, global = true)]
    pub profile: bool,
    /// Messages about progress and logs on the standard error: plain text or one JSON object a line
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text)]
    pub log_format: LogFormat,
    /// Which logs: error, warn, info, debug, trace or a filter such as jamhpc=debug [default: warn, for json info]
    #[arg(long, global = true, value_name = "LEVEL", env = "JAMHPC_LOG", value_parser = log_filter)]
    pub log_level: Option<EnvFilter>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Starter {
    Sp,
    Dp,
    Study,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    Text,
    Json,
}

impl ValueEnum for Extra {
    fn value_variants<'a>() -> &'a [Self] {
        &[Extra::Voids, Extra::Moduli, Extra::QuasiStatic, Extra::Spectrum, Extra::Approximations]
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        Some(match self {
            Extra::Voids => clap::builder::PossibleValue::new("voids").help("Every void, and their statistics"),
            Extra::Moduli => clap::builder::PossibleValue::new("moduli").help("Elastic moduli by linear response"),
            Extra::QuasiStatic => clap::builder::PossibleValue::new("quasi-static")
                .help("Moduli, and that relaxed strains of the box give the same shear modulus to 1e-6"),
            Extra::Spectrum => clap::builder::PossibleValue::new("spectrum")
                .help("All eigenvalues of the Hessian, of up to 1000 points; zero and negative ones"),
            Extra::Approximations => clap::builder::PossibleValue::new("approximations")
                .help("Packing fractions of disks by the paper's Eqs. 9, 10 and 12, and their errors"),
        })
    }
}

impl ValueEnum for Method {
    fn value_variants<'a>() -> &'a [Self] {
        &[Method::Fire, Method::Cg, Method::Newton]
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        Some(match self {
            Method::Fire => "fire".into(),
            Method::Cg => "cg".into(),
            Method::Newton => "newton".into(),
        })
    }
}

impl ValueEnum for ColorBy {
    fn value_variants<'a>() -> &'a [Self] {
        &[ColorBy::Z, ColorBy::ShapeParameter, ColorBy::Pressure]
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        Some(match self {
            ColorBy::Z => "z".into(),
            ColorBy::ShapeParameter => "shape_parameter".into(),
            ColorBy::Pressure => "pressure".into(),
        })
    }
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x > 0.0 && x.is_finite() => Ok(x),
        _ => Err("give a number above 0, such as 1e-9".into()),
    }
}

fn n_threads(text: &str) -> Result<u16, String> {
    let number = text.parse::<u16>().ok().filter(|number| (1..=1024).contains(number));
    number.ok_or_else(|| "give a whole number from 1 to 1024, here or in RAYON_NUM_THREADS".into())
}

fn figure_number(text: &str) -> Result<u8, String> {
    let number = text.parse::<u8>().ok().filter(|number| NUMBERS.contains(number));
    number.ok_or_else(|| format!("give one of {}", NUMBERS.map(|n| n.to_string()).join(", ")))
}

/// The filter's own `FromStr` passes over what it does not understand.
fn log_filter(text: &str) -> Result<EnvFilter, String> {
    EnvFilter::try_new(text).map_err(|e| e.to_string())
}

/// The flags, or the exit code after usage, help or a complaint has been printed once. Collective.
pub fn parse(comm: &Comm) -> Result<Cli, u8> {
    let parsed = Cli::try_parse();
    // ranks may have been started with different arguments; then all of them end
    let wrong = comm.max(parsed.as_ref().map_or_else(|e| e.exit_code() as f64, |_| -1.0));
    match parsed {
        Ok(cli) if wrong < 0.0 => Ok(cli),
        Ok(_) => {
            if comm.is_root() {
                tell("error: the ranks were started with different arguments, and some are not valid\n");
            }
            Err(exit::BAD_INPUT)
        }
        Err(error) => {
            if comm.is_root() {
                // nothing can be done about a terminal that has gone away
                let _ = error.print();
            }
            Err(wrong as u8)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_flags_are_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn settings_may_stand_before_or_after_the_command() {
        let cli = Cli::try_parse_from(["jamhpc", "run", "a.toml", "--threads", "3", "--set", "seed=2"]).unwrap();
        assert_eq!(cli.settings.threads, 3);
        let Some(Command::Run { options, check: false, .. }) = cli.command else { panic!() };
        assert_eq!(options.set, ["seed=2"]);
        let cli = Cli::try_parse_from(["jamhpc", "-o", "x", "--set", "seed=2", "--threads", "2"]).unwrap();
        assert!(cli.command.is_none() && cli.options.output.is_some() && cli.settings.threads == 2);
    }
}
