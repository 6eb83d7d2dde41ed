//! The program as a user meets it: what it prints, which files it leaves, how it refuses bad input.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Seconds after which a program that hangs is ended, with exit code 124.
const LIMIT: &str = "60";

/// An empty folder in which the program is started.
struct Place {
    folder: TempDir,
}

/// A run that a test is going to end.
struct Running {
    child: Child,
}

impl Running {
    /// Waits until something has come true, while the program runs.
    #[track_caller]
    fn until(&mut self, is_true: impl Fn() -> bool) {
        let start = Instant::now();
        while !is_true() {
            assert!(self.child.try_wait().unwrap().is_none(), "the run has ended before it was interrupted");
            assert!(start.elapsed() < Duration::from_secs(60), "the run hangs");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn signal(&self, name: &str) {
        let sent = Command::new("kill").args([format!("-{name}"), self.child.id().to_string()]).status().unwrap();
        assert!(sent.success());
    }

    fn end(mut self) -> Outcome {
        let start = Instant::now();
        while self.child.try_wait().unwrap().is_none() {
            if start.elapsed() > Duration::from_secs(60) {
                self.child.kill().unwrap();
                panic!("the run hangs");
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        Outcome::from(self.child.wait_with_output().unwrap())
    }
}

/// How a program ended and what it said.
struct Outcome {
    code: Option<i32>,
    stdout: String,
    stderr: String,
}

impl Place {
    fn new() -> Self {
        Place { folder: tempfile::tempdir().unwrap() }
    }

    /// In memory, where there is such a folder: hundreds of checkpoints are hard on a disk.
    fn in_memory(scene: &str) -> Self {
        let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
        let place = Place { folder };
        place.write("scene.toml", scene);
        place
    }

    fn with(name: &str, text: &str) -> Self {
        let place = Place::new();
        place.write(name, text);
        place
    }

    fn path(&self) -> &Path {
        self.folder.path()
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path().join(name), text).unwrap();
    }

    fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    /// All files and folders below, sorted.
    fn files(&self) -> Vec<PathBuf> {
        fn collect(folder: &Path, into: &mut Vec<PathBuf>) {
            for entry in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
                if entry.is_dir() {
                    collect(&entry, into);
                }
                into.push(entry);
            }
        }
        let mut all = Vec::new();
        collect(self.path(), &mut all);
        all.sort();
        all
    }

    /// `jamhpc` with these arguments, as a single process.
    fn jamhpc(&self, arguments: &[&str]) -> Outcome {
        self.start(&[], arguments)
    }

    /// The same on `ranks` ranks.
    fn ranks(&self, ranks: u32, arguments: &[&str]) -> Outcome {
        let launcher = std::env::var("MPIRUN").unwrap_or_else(|_| "mpirun".into());
        let ranks = ranks.to_string();
        let words: Vec<&str> = launcher.split_whitespace().chain(["-n", &ranks]).collect();
        self.start(&words, arguments)
    }

    fn start(&self, launcher: &[&str], arguments: &[&str]) -> Outcome {
        let words = [&[LIMIT], launcher, &[env!("CARGO_BIN_EXE_jamhpc")], arguments].concat();
        Outcome::from(self.command("timeout", &words).output().unwrap())
    }

    /// `jamhpc` as a single process that is not waited for.
    fn spawn(&self, arguments: &[&str]) -> Running {
        let mut command = self.command(env!("CARGO_BIN_EXE_jamhpc"), arguments);
        Running { child: command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap() }
    }

    fn command(&self, program: &str, arguments: &[&str]) -> Command {
        let mut command = Command::new(program);
        command
            .args(arguments)
            .current_dir(self.path())
            // Open MPI: as root in a container, more ranks than cores
            .envs(["OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM"].map(|name| (name, "1")))
            .env("OMPI_MCA_rmaps_base_oversubscribe", "1")
            .env("PRTE_MCA_rmaps_default_mapping_policy", ":oversubscribe")
            .env("OMPI_MCA_hwloc_base_binding_policy", "none")
            .env("OMPI_MCA_mpi_yield_when_idle", "1")
            .env("RAYON_NUM_THREADS", "1")
            .env_remove("JAMHPC_LOG");
        command
    }

    /// Refused with exit code 2 and one message that says all of `expected`; nothing was written.
    fn refuses(&self, arguments: &[&str], expected: &[&str]) {
        let before = self.files();
        self.jamhpc(arguments).is_refusal(expected);
        assert_eq!(self.files(), before, "{arguments:?} left files behind");
    }
}

impl Outcome {
    fn from(output: Output) -> Self {
        Outcome {
            code: output.status.code(),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        }
    }

    #[track_caller]
    fn succeeds(self) -> Self {
        assert_eq!(self.code, Some(0), "{}", self.stderr);
        assert!(!self.stderr.contains("error:"), "{}", self.stderr);
        self
    }

    #[track_caller]
    fn fails_with(&self, code: i32, expected: &[&str]) {
        assert_eq!(self.code, Some(code), "{}", self.stderr);
        let messages: Vec<&str> = self.stderr.lines().filter(|line| line.starts_with("error: ")).collect();
        assert_eq!(messages.len(), 1, "{}", self.stderr);
        for part in expected {
            assert!(messages[0].contains(part), "`{part}` is not in: {}", messages[0]);
        }
        assert!(!self.stderr.contains("panicked") && !self.stderr.contains("internal error"), "{}", self.stderr);
    }

    #[track_caller]
    fn is_refusal(&self, expected: &[&str]) {
        self.fails_with(2, expected);
    }
}

/// A scene that is done in a second.
const QUICK_SP: &str = "model = 'sp'\nn_particles = 32\n[compression]\nincrements = [1e-3, 1e-2]\n";

// ---------------------------------------------------------------------------------------------------------------------
// Good paths

#[test]
fn help_and_version() {
    let help = Place::new().jamhpc(&["--help"]).succeeds().stdout;
    for part in
        ["Examples:", "Exit codes:", "evaluate", "minimize", "analyze", "check", "render", "info", "init", "--threads"]
    {
        assert!(help.contains(part), "{part}");
    }
    let version = Place::new().jamhpc(&["--version"]).succeeds().stdout;
    assert!(version.starts_with(concat!("jamhpc ", env!("CARGO_PKG_VERSION"))), "{version}");
}

#[test]
fn help_is_printed_once_for_all_ranks() {
    let help = Place::new().ranks(2, &["--help"]).succeeds().stdout;
    assert_eq!(help.matches("Usage:").count(), 1, "{help}");
}

#[test]
fn a_starter_scene_is_valid_and_never_overwritten() {
    let place = Place::new();
    for model in ["sp", "dp"] {
        let file = format!("{model}.toml");
        let printed = place.jamhpc(&["init", model]).succeeds().stdout;
        assert_eq!(place.jamhpc(&["init", model, "-o", "-"]).succeeds().stdout, printed);
        place.jamhpc(&["init", model, "-o", &file]).succeeds();
        assert_eq!(printed.as_bytes(), place.read(&file));
        let whole = place.jamhpc(&["run", &file, "--check"]).succeeds().stdout;
        assert!(whole.contains(&format!("model = \"{model}\"")), "{whole}");
        place.refuses(&["init", model, "-o", &file], &[&file, "exists already"]);
    }
    assert_eq!(place.files().len(), 2, "a check writes nothing");
}

#[test]
fn a_run_prints_its_samples_and_leaves_files_that_other_commands_read() {
    let place = Place::with("scene.toml", QUICK_SP);
    let run = place.jamhpc(&["run", "scene.toml", "-o", "out"]).succeeds();
    assert!(run.stdout.contains("onset: phi_J = 0.8"), "{}", run.stdout);
    let samples = run.stdout.lines().filter(|line| line.starts_with("0.8"));
    assert_eq!(samples.count(), 3, "{}", run.stdout);
    let names = ["packing.png", "packing.svg", "plot.png", "plot.svg", "results.h5"];
    let expected: Vec<PathBuf> = names.iter().map(|name| place.path().join("out").join(name)).collect();
    assert_eq!(place.files()[1..6], expected);
    for name in names {
        assert!(run.stdout.contains(&format!("kB  out/{name}")), "{}", run.stdout);
    }

    let info = place.jamhpc(&["info", "out/results.h5"]).succeeds().stdout;
    assert!(info.contains("complete") && info.contains("32 particles"), "{info}");
    // one name for one thing
    let headings = |text: &str| -> Vec<String> {
        let line = text.lines().find(|line| line.contains("max|F|")).unwrap();
        line.split_whitespace().map(str::to_owned).collect()
    };
    for heading in &headings(&info)[1..] {
        assert!(headings(&run.stdout).contains(heading), "{info}");
    }
    for picture in ["onset.svg", "onset.png"] {
        place.jamhpc(&["render", "out/results.h5", "--frame", "0", "--color-by", "pressure", "-o", picture]).succeeds();
        assert!(place.read(picture).len() > 1000);
    }
    place.jamhpc(&["render", "out/results.h5", "--frame", "0", "--part", "0.3", "-o", "part.svg"]).succeeds();
    let part = String::from_utf8_lossy(&place.read("part.svg")).into_owned();
    assert!(part.len() < place.read("onset.svg").len() / 2 && part.contains("0.300 of"), "{part}");
    let evaluation = place.jamhpc(&["evaluate", "out/results.h5", "--frame", "1"]).succeeds().stdout;
    assert!(evaluation.starts_with("{\"energy\":"), "{evaluation}");
    place.jamhpc(&["minimize", "out/results.h5", "-o", "relaxed.json"]).succeeds();
    place.jamhpc(&["evaluate", "relaxed.json", "-o", "evaluation.json"]).succeeds();
    assert!(place.read("evaluation.json").starts_with(b"{\"energy\":"));
    let printed = place.jamhpc(&["evaluate", "relaxed.json", "-o", "-"]).succeeds().stdout;
    assert_eq!(printed.as_bytes(), place.read("evaluation.json"));

    let valid = place.jamhpc(&["check", "out/results.h5"]).succeeds().stdout;
    assert!(valid.contains("frame 2: stored packing_fraction") && !valid.contains("FAILED"), "{valid}");
    place.ranks(2, &["check", "out/results.h5", "--frame", "1"]).succeeds();
    let strict = place.jamhpc(&["check", "out/results.h5", "--force-tolerance", "1e-30"]);
    strict.fails_with(1, &["out/results.h5 is not valid"]);
    assert!(strict.stderr.contains("frame 0: max|F|"), "{}", strict.stderr);
    let one = place.jamhpc(&["analyze", "out/results.h5", "--frame", "2"]).succeeds().stdout;
    assert_eq!(one, place.ranks(2, &["analyze", "out/results.h5"]).succeeds().stdout);
    let all = place.jamhpc(&["analyze", "out/results.h5", "--all"]).succeeds().stdout;
    let table: Vec<Vec<&str>> = all.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(table.len(), 4);
    assert_eq!((table[0][0], table[3][0]), ("frame", "2"));
    for name in ["density", "strain", "contact_number", "mean_shear_modulus", "stress_virial_xy"] {
        let column = table[0].iter().position(|&column| column == name).unwrap_or_else(|| panic!("{name}: {all}"));
        let line = one.lines().find(|line| line.starts_with(&format!("{name} "))).unwrap();
        assert_eq!(line.split_whitespace().nth(1), Some(table[3][column]));
    }

    place.refuses(&["analyze", "relaxed.json", "--all"], &["relaxed.json", "leave"]);
    place.refuses(&["check", "out/results.h5", "--frame", "7"], &["no frame 7"]);
    place.refuses(&["render", "out/results.h5", "--frame", "3", "-o", "x.svg"], &["no frame 3", "0 to 2"]);
    place.refuses(&["render", "out/results.h5", "-o", "x.pdf"], &["x.pdf", ".svg or .png"]);
    place.refuses(&["render", "out/results.h5", "--part", "2", "-o", "x.svg"], &["--part 2", "not above 1"]);
    place.refuses(&["evaluate", "relaxed.json", "--frame", "0"], &["--frame", "relaxed.json"]);
    place.refuses(&["run", "out/results.h5"], &["results.h5", "not a text file"]);

    // results are never overwritten
    let again = place.jamhpc(&["run", "scene.toml", "-o", "out"]).succeeds();
    assert_eq!(again.stdout.lines().next(), run.stdout.lines().next());
    assert!(again.stdout.contains("older results are now out/results.1.h5"), "{}", again.stdout);
    assert_eq!(place.read("out/results.h5"), place.read("out/results.1.h5"));
}

#[test]
fn an_onset_above_the_densities_that_are_wanted_is_said() {
    let place = Place::with("scene.toml", &QUICK_SP.replace("increments = [1e-3, 1e-2]", "until = 0.6"));
    let run = place.jamhpc(&["run", "scene.toml"]).succeeds();
    assert!(run.stderr.contains("`compression.until` = 0.6 is not above the onset at 0.8"), "{}", run.stderr);
}

#[test]
fn files_of_others_stay() {
    let place = Place::with("scene.toml", QUICK_SP);
    std::fs::create_dir_all(place.path().join("out/checkpoint")).unwrap();
    place.write("out/checkpoint/notes.txt", "mine");
    place.jamhpc(&["run", "scene.toml", "-o", "out"]).succeeds();
    assert_eq!(place.read("out/checkpoint/notes.txt"), b"mine");
}

#[test]
fn any_number_of_ranks_and_threads_writes_the_same_bytes() {
    let place = Place::with("scene.toml", &QUICK_SP.replace("32", "64"));
    let run = |out: &str, launch: &dyn Fn(&[&str]) -> Outcome| {
        let outcome = launch(&["run", "scene.toml", "-o", out]).succeeds();
        let table: Vec<String> = outcome.stdout.lines().take(6).map(String::from).collect();
        let files = ["results.h5", "packing.svg", "plot.svg"].map(|name| place.read(&format!("{out}/{name}")));
        (table, files)
    };
    let alone = run("one", &|arguments| place.jamhpc(arguments));
    let two = run("two", &|arguments| place.ranks(2, arguments));
    let threads = run("threads", &|arguments| place.jamhpc(&[arguments, &["--threads", "2"]].concat()));
    assert!(alone == two && alone == threads);
}

// ---------------------------------------------------------------------------------------------------------------------
// Bad input

#[test]
fn bad_scenes_are_refused() {
    for (text, expected) in [
        ("", &["scene.toml", "empty", "jamhpc init"] as &[&str]),
        ("model = 'sp'\nn_partcles = 3\n", &["scene.toml:2", "`n_partcles`", "did you mean `n_particles`"]),
        ("model = 'sp'\nn_particles = 'many'\n", &["scene.toml:2", "`n_particles`", "an integer from 2"]),
        ("model = 'sp'\n[initial]\npacking_fraction = 3\n", &["scene.toml:3", "`initial.packing_fraction`", "0.7"]),
        ("model = 'sp'\n[potential]\ndelta = 0.1\n", &["scene.toml:3", "`potential.delta`", "dp"]),
    ] {
        Place::with("scene.toml", text).refuses(&["run", "scene.toml"], expected);
    }
}

#[test]
fn a_box_in_which_a_particle_meets_its_own_image_is_refused() {
    let place = Place::with("scene.toml", "model = 'sp'\nn_particles = 4\n");
    place.refuses(&["run", "scene.toml"], &["box is too small", "more particles"]);
    place.refuses(&["run", "scene.toml", "--check"], &["box is too small", "more particles"]);
    place.jamhpc(&["run", "scene.toml", "--check", "--set", "n_particles=16"]).succeeds();
    let triangles = Place::with("scene.toml", "model = 'dp'\nn_particles = 6\nparticles.n_vertices = [3]\n");
    triangles.refuses(&["run", "scene.toml"], &["edges as long as 1.5197", "more vertices"]);
    triangles.refuses(&["run", "scene.toml", "--check"], &["edges as long as 1.5197", "more vertices"]);
    triangles.jamhpc(&["run", "scene.toml", "--check", "--set", "n_particles=16"]).succeeds();
}

#[test]
fn disks_at_one_place_are_not_relaxed() {
    let disks = "{\"model\":\"sp\",\"box\":{\"lx\":4,\"ly\":4},\"epsilon\":1,\"diameters\":[1,1,1.4],\
                 \"positions\":[[1,1],[3,2],[1,1]]}";
    let place = Place::with("disks.json", disks);
    place.refuses(&["minimize", "disks.json", "-o", "out.json"], &["disks 0 and 2 lie at one place", "move"]);
    let check = place.jamhpc(&["check", "disks.json"]);
    check.fails_with(1, &["disks.json is not valid"]);
    assert!(check.stderr.contains("disks at one place") && check.stderr.contains("(particles 0 and 2)"));
    place.jamhpc(&["evaluate", "disks.json"]).succeeds();
}

#[test]
fn bad_configurations_are_refused() {
    let square = |corners: &str| {
        format!(
            "{{\"model\":\"dp\",\"box\":{{\"lx\":4,\"ly\":4}},\"line_tension\":1,\"k_area\":100,\"epsilon\":10,\
             \"delta\":0.1,\"n_vertices\":[4],\"a0\":[1],\"vertices\":[{corners}]}}"
        )
    };
    let disks = |rest: &str| format!("{{\"model\":\"sp\",\"box\":{{\"lx\":1,\"ly\":4}},\"epsilon\":1,{rest}}}");
    let place = Place::new();
    place.write("right.json", &square("[0,0],[1,0],[1,1],[0,1]"));
    place.jamhpc(&["evaluate", "right.json"]).succeeds();
    for (text, expected) in [
        (String::new(), "empty"),
        ("{".into(), "not JSON"),
        (square("[0,0],[0,1],[1,1],[1,0]"), "clockwise"),
        (square("[0,0],[1,1],[1,0],[0,1.5]"), "crosses itself"),
        (square("[0,0],[1,0],[1,1]"), "`vertices`"),
        (disks("\"diameters\":[1],\"positions\":[[0,0]]"), "box is too small"),
        (disks("\"diameters\":[1],\"positions\":[[0,0]],\"delta\":1"), "`delta`"),
    ] {
        place.write("bad.json", &text);
        place.refuses(&["evaluate", "bad.json"], &["bad.json", expected]);
        place.refuses(&["minimize", "bad.json", "-o", "out.json"], &["bad.json", expected]);
    }
}

#[test]
fn overrides_are_checked_like_the_scene() {
    let place = Place::with("scene.toml", QUICK_SP);
    place.refuses(&["run", "scene.toml", "--set", "seed=-1"], &["--set seed=-1", "`seed`"]);
    place.refuses(&["--set", "potential.delta=7"], &["`potential.delta`", "0.5"]);
}

#[test]
fn files_that_cannot_be_read_are_refused() {
    let place = Place::new();
    place.refuses(&["run", "missing.toml"], &["missing.toml", "No such file"]);
    place.refuses(&["run", "."], &["cannot read ."]);
    std::fs::write(place.path().join("binary.toml"), [0x89, 0x48, 0xff, 0xfe]).unwrap();
    place.refuses(&["run", "binary.toml"], &["binary.toml", "not a text file"]);
    for command in [&["evaluate", "missing.json"] as &[&str], &["info", "missing.h5"]] {
        place.refuses(command, &["missing."]);
    }
}

#[test]
fn a_folder_that_cannot_be_written_is_refused_before_any_work() {
    let place = Place::with("scene.toml", QUICK_SP);
    place.write("file", "");
    place.refuses(&["run", "scene.toml", "-o", "file"], &["file"]);
    place.refuses(&["run", "scene.toml", "-o", "file/below"], &["file/below"]);
    place.refuses(&["run", "scene.toml", "-o", "/proc/nothing"], &["/proc/nothing"]);
    // so early that nothing is known of the input yet
    for command in ["evaluate", "minimize", "analyze", "render"] {
        place.refuses(&[command, "missing.json", "-o", "nowhere/out.svg"], &["nowhere/out.svg", "check the path"]);
    }
    place.refuses(&["evaluate", "missing.json", "-o", "."], &["cannot write .", "name a file"]);
}

#[test]
fn wrong_flags_are_refused() {
    let place = Place::new();
    place.refuses(&["--restart"], &["unexpected argument", "--restart"]);
    place.refuses(&["run"], &["required"]);
    place.refuses(&["dance"], &["dance"]);
    place.refuses(&["--threads", "0"], &["--threads", "1 to 1024", "RAYON_NUM_THREADS"]);
    place.refuses(&["--log-level", "jamhpc=loud"], &["--log-level"]);
}

#[test]
fn ranks_refuse_together_and_speak_once() {
    let place = Place::with("scene.toml", QUICK_SP);
    place.write("bad.toml", "model = 'sp'\nn_partcles = 3\n");
    place.write("tiny.toml", "model = 'sp'\nn_particles = 4\n");
    let before = place.files();
    place.ranks(2, &["run", "bad.toml"]).is_refusal(&["bad.toml:2", "`n_partcles`"]);
    place.ranks(2, &["run", "missing.toml"]).is_refusal(&["missing.toml"]);
    place.ranks(2, &["run", "tiny.toml"]).is_refusal(&["box is too small"]);
    place.ranks(2, &["run", "scene.toml", "-o", "scene.toml"]).is_refusal(&["scene.toml"]);
    place.ranks(2, &["run"]).is_refusal(&["required"]);
    // eight ranks do not fit a box of 32 disks
    place.ranks(8, &["run", "scene.toml"]).is_refusal(&["8 ranks do not fit", "mpirun -n"]);
    place.ranks(8, &["run", "scene.toml", "--check"]).is_refusal(&["8 ranks do not fit", "mpirun -n"]);
    assert_eq!(place.files(), before);
}

#[test]
fn evaluations_are_the_same_on_any_number_of_ranks() {
    let place = Place::new();
    place.write("sp.json", include_str!("cases/sp_n64_phi090.json"));
    place.write("dp.json", include_str!("cases/dp_jammed_rho095.json"));
    for (file, ranks) in [("sp.json", [2, 4]), ("dp.json", [2, 4])] {
        let evaluate = ["evaluate", file, "--with", "moduli,voids"];
        let alone = place.jamhpc(&evaluate).succeeds().stdout;
        assert!(alone.contains("\"shear_modulus\":{\"linear_response\":") && alone.contains("\"voids\":["), "{alone}");
        for n in ranks {
            assert_eq!(place.ranks(n, &evaluate).succeeds().stdout, alone, "{file} on {n} ranks");
        }
    }
    place.refuses(&["evaluate", "sp.json", "--with", "moduly"], &["moduly", "--with"]);
}

// ---------------------------------------------------------------------------------------------------------------------
// Invalid states

#[test]
fn a_check_fails_loudly() {
    let place = Place::new();
    let disks = |positions: &str| {
        format!(
            "{{\"model\":\"sp\",\"box\":{{\"lx\":4,\"ly\":4}},\"epsilon\":1,\"diameters\":[1,1],\"positions\":[{positions}]}}"
        )
    };
    place.write("apart.json", &disks("[0,0],[2,2]"));
    place.write("pressed.json", &disks("[0,0],[0.9,0]"));
    let apart = place.jamhpc(&["check", "apart.json"]).succeeds().stdout;
    assert!(apart.contains("max|F|"), "{apart}");
    for ranks in [1, 2] {
        let pressed = place.ranks(ranks, &["check", "pressed.json"]);
        pressed.fails_with(1, &["pressed.json is not valid"]);
        assert!(pressed.stderr.contains("max|F|: 1.000e-1, limit 1.000e-8"), "{}", pressed.stderr);
    }
    // what nothing holds has numbers all the same
    let measured = place.jamhpc(&["analyze", "apart.json"]).succeeds().stdout;
    for (name, value) in
        [("contact_number", "0"), ("shear_modulus", "0"), ("n_rattlers", "2"), ("moduli_are_stable", "1")]
    {
        let line = measured.lines().find(|line| line.starts_with(&format!("{name} "))).unwrap();
        assert_eq!(line.split_whitespace().nth(1), Some(value), "{measured}");
    }
    assert!(!measured.contains("NaN"), "{measured}");
}

/// Adds to the first number of a dataset of a results file.
fn alter(file: &Path, dataset: &str, by: f64) {
    let file = hdf5::File::open_rw(file).unwrap();
    let dataset = file.dataset(dataset).unwrap();
    let mut values = dataset.read_dyn::<f64>().unwrap();
    *values.iter_mut().next().unwrap() += by;
    dataset.write(values.view()).unwrap();
}

#[test]
fn a_check_finds_altered_numbers() {
    let place = Place::with("scene.toml", QUICK_SP);
    place.jamhpc(&["run", "scene.toml", "-o", "out"]).succeeds();
    let file = place.path().join("out/results.h5");
    place.jamhpc(&["check", "out/results.h5"]).succeeds();
    for (dataset, by, says) in [
        ("observables/pressure/value", 1e-9, "frame 0: stored pressure"),
        ("observables/contact_number/value", 1.0, "frame 0: stored contact_number"),
        ("observables/stress_virial/value", 1e-9, "frame 0: stored stress_virial 0"),
        ("observables/particles/area/value", 1e-6, "frame 0: stored area of particles"),
        ("observables/particles/is_rattler/value", 1.0, "frame 0: stored is_rattler of particles"),
        ("observables/particles/perimeter/value", f64::NAN, "frame 0: stored perimeter of particles"),
    ] {
        let sound = place.read("out/results.h5");
        alter(&file, dataset, by);
        for ranks in [1, 2] {
            let checked = place.ranks(ranks, &["check", "out/results.h5"]);
            checked.fails_with(1, &["out/results.h5 is not valid"]);
            assert!(checked.stderr.contains(says), "{dataset}: {}", checked.stderr);
        }
        std::fs::write(&file, sound).unwrap();
    }
    // more samples than a file of its length holds: the lengths of all series so far and at most
    let open = hdf5::File::open(&file).unwrap();
    let frames = open.dataset("particles/all/position/step").unwrap().size() as u64;
    drop(open);
    let lengths = |frames: u64| [frames.to_le_bytes(), [255; 8]].concat();
    let (before, after) = (lengths(frames), lengths(4_000_000_000_000));
    let mut bytes = std::fs::read(&file).unwrap();
    for k in 0..bytes.len() - 16 {
        if bytes[k..].starts_with(&before) {
            bytes[k..k + 16].copy_from_slice(&after);
        }
    }
    std::fs::write(&file, bytes).unwrap();
    place.refuses(&["analyze", "out/results.h5", "--all"], &["out/results.h5", "damaged: 4000000000000 samples"]);
}

#[test]
fn given_densities_need_no_onset() {
    let scene = "model = 'sp'\nn_particles = 64\n[compression]\ndensities = [0.7, 0.88]\n[output]\npicture = false";
    let place = Place::with("scene.toml", scene);
    let run = place.jamhpc(&["run", "scene.toml", "-o", "out"]).succeeds();
    assert!(!run.stdout.contains("onset"), "{}", run.stdout);
    let rows: Vec<Vec<&str>> = run.stdout.lines().skip(2).take(2).map(|l| l.split_whitespace().collect()).collect();
    // below jamming nothing is held
    assert_eq!((rows[0][1], rows[0][2]), ("0.700000", "0.000"), "{}", run.stdout);
    assert_eq!(rows[1][1], "0.880000", "{}", run.stdout);
    place.jamhpc(&["check", "out/results.h5"]).succeeds();
    let unsorted = ["run", "scene.toml", "--set", "compression.densities=[0.9, 0.8]"];
    place.refuses(&unsorted, &["compression.densities", "ascend", "[0.9, 0.8]"]);
}

// ---------------------------------------------------------------------------------------------------------------------
// Not converged

#[test]
fn a_state_that_does_not_converge_ends_with_its_own_code() {
    let place = Place::with("scene.toml", QUICK_SP);
    let few = ["run", "scene.toml", "-o", "out", "--set", "minimize.max_iterations=3"];
    place.jamhpc(&few).fails_with(3, &["not converged", "minimize.max_iterations"]);
    place.ranks(2, &few).fails_with(3, &["not converged"]);
    let info = place.jamhpc(&["info", "out/results.h5"]).succeeds().stdout;
    assert!(info.contains("ended early: not converged") && info.contains("samples    0"), "{info}");
}

#[test]
fn outlines_that_only_just_touch_relax() {
    // conjugate gradients alone are lost below the onset of this packing
    let place = Place::with("scene.toml", "model = 'dp'\nn_particles = 16\nseed = 6\npotential.preset = 'paper'\n");
    let settings = ["onset.step=0.01", "compression.increments=[0.01]", "minimize.max_iterations=200_000"];
    let arguments = [vec!["run", "scene.toml", "-o", "out"], settings.iter().flat_map(|&s| ["--set", s]).collect()];
    let run = place.jamhpc(&arguments.concat()).succeeds();
    assert!(run.stdout.contains("onset: rho_J = 0.824"), "{}", run.stdout);
}

#[test]
fn a_relaxation_that_does_not_converge_hands_its_state_on() {
    let place = Place::new();
    let disks = "{\"model\":\"sp\",\"box\":{\"lx\":4,\"ly\":4},\"epsilon\":1,\
                 \"diameters\":[1,1],\"positions\":[[0,0],[0.5,0]]}";
    place.write("start.json", disks);
    let outcome = place.jamhpc(&["minimize", "start.json", "-o", "end.json", "--max-iterations", "2"]);
    outcome.fails_with(3, &["not converged", "end.json", "--max-iterations"]);
    assert!(String::from_utf8(place.read("end.json")).unwrap().contains("\"converged\":false"));
    place.jamhpc(&["evaluate", "end.json", "-o", "end.json"]).fails_with(2, &["end.json is what is read", "-o"]);
    place.jamhpc(&["minimize", "end.json", "-o", "end.json"]).succeeds();
    assert!(String::from_utf8(place.read("end.json")).unwrap().contains("\"converged\":true"));
}

// ---------------------------------------------------------------------------------------------------------------------
// Interrupted and resumed

/// Some seconds of work with every phase of a run in it, and a checkpoint every 64 iterations.
const INTERRUPTED: [&str; 2] = [
    "model = 'sp'\nn_particles = 128\n[compression]\nincrements = [1e-2]\n[shear]\nuntil = 0.01\n\
     [checkpoint]\ninterval = 0\n",
    "model = 'dp'\nn_particles = 24\n[onset]\nstep = 0.04\npressure = [1e-2, 0.1]\n[compression]\nincrements = [1e-2]\n\
     [minimize]\nmethod = 'fire'\nforce_tolerance = 1e-3\n[checkpoint]\ninterval = 0\n",
];
const RUN: [&str; 4] = ["run", "scene.toml", "-o", "out"];
const RESUME: [&str; 5] = ["run", "scene.toml", "-o", "out", "--resume"];

/// Files of a checkpoint whose names begin like this.
fn checkpoint_files(place: &Path, start: &str) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(place.join("out/checkpoint")) else { return Vec::new() };
    let paths = entries.map(|entry| entry.unwrap().path());
    let mut files: Vec<PathBuf> = paths
        .filter(|path| path.extension().is_some_and(|e| e == "records"))
        .filter(|path| path.file_name().unwrap().to_string_lossy().starts_with(start))
        .collect();
    files.sort();
    files
}

/// A run that was killed when it had written so many files of outcomes and then some of the next minimisation.
fn killed(place: &Place, arguments: &[&str], outcomes: usize) {
    let mut running = place.spawn(arguments);
    let place = place.path();
    running.until(|| checkpoint_files(place, "done").len() >= outcomes);
    let now = checkpoint_files(place, "running").first().and_then(|file| file.metadata().ok()?.modified().ok());
    running.until(|| {
        let file = checkpoint_files(place, "running-before");
        file.first().is_some_and(|file| file.metadata().is_ok_and(|m| m.modified().ok() != now))
    });
    running.signal("KILL");
    assert_eq!(running.end().code, None);
}

#[test]
fn a_killed_run_goes_on_to_the_same_bytes() {
    for (scene, ranks) in [(INTERRUPTED[0], 1..=4), (INTERRUPTED[1], 3..=3)] {
        let undisturbed = Place::in_memory(scene);
        let table = |outcome: Outcome| outcome.succeeds().stdout.lines().take(6).map(String::from).collect::<Vec<_>>();
        let expected = table(undisturbed.jamhpc(&[&RUN[..], &["--set", "checkpoint.interval=600"]].concat()));
        assert_eq!(table(undisturbed.jamhpc(&RUN)), expected);
        let names: Vec<PathBuf> = undisturbed.files().iter().map(|f| f.file_name().unwrap().into()).collect();
        assert!(!names.contains(&"checkpoint".into()), "{names:?}");
        for ranks in ranks {
            let place = Place::in_memory(scene);
            killed(&place, &RUN, ranks);
            killed(&place, &RESUME, ranks + 2);
            assert_eq!(table(place.ranks(ranks as u32, &RESUME)), expected, "{ranks} ranks");
            assert!(place.read("out/results.h5") == undisturbed.read("out/results.h5"), "{ranks} ranks");
            assert!(!place.path().join("out/checkpoint").exists());
        }
    }
}

#[test]
fn what_is_missing_of_a_checkpoint_is_done_again() {
    let scene = INTERRUPTED[0];
    let undisturbed = Place::in_memory(scene);
    undisturbed.jamhpc(&RUN).succeeds();
    let damage = |file: &Path| {
        let mut bytes = std::fs::read(file).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        std::fs::write(file, bytes).unwrap();
    };
    for (start, which) in [("running.", 0), ("running-before", 0), ("done", 0), ("done", 3)] {
        let place = Place::in_memory(scene);
        killed(&place, &RUN, 6);
        // a kill between the two renames of a checkpoint leaves the older state only
        while checkpoint_files(place.path(), start).len() <= which {
            killed(&place, &RESUME, 6);
        }
        let file = &checkpoint_files(place.path(), start)[which];
        damage(file);
        let outcome = place.ranks(2, &RESUME).succeeds();
        // the older state of a minimisation is looked at only if the newer one is no good, or of another
        let is_told = outcome.stderr.contains("is damaged (its checksum is wrong); what it was about is done again");
        assert!(is_told || start == "running-before", "{}", outcome.stderr);
        assert!(place.read("out/results.h5") == undisturbed.read("out/results.h5"), "{file:?}");
    }
}

#[test]
fn a_checkpoint_of_something_else_is_refused() {
    let place = Place::in_memory(INTERRUPTED[0]);
    place.refuses(&RESUME, &["no checkpoint in out/checkpoint", "Leave --resume out"]);
    killed(&place, &RUN, 2);
    place.refuses(&RUN, &["out/checkpoint", "has not ended", "--resume"]);
    place.refuses(&[&RESUME[..], &["--set", "seed=2"]].concat(), &["`seed` is 2, but 1", "scene.toml"]);
    place.refuses(
        &[&RESUME[..], &["--set", "compression.until=0.9"]].concat(),
        &["`compression.increments` is absent, but [0.01]"],
    );
    // what does not decide results may change
    let picture = [&RESUME[..], &["--set", "output.picture=false", "--set", "checkpoint.interval=60"]].concat();
    place.jamhpc(&picture).succeeds();
}

#[test]
fn signals_write_checkpoints() {
    for signal in ["TERM", "USR2"] {
        ended_by(signal);
    }
}

#[test]
fn a_signal_ends_newtons_method() {
    // forces never get as small as this, and iterations last for hours
    let place = Place::in_memory(
        "model = 'dp'\nn_particles = 64\n[initial]\npacking_fraction = 0.7\n[compression]\ndensities = [0.72]\n\
         [minimize]\nmethod = 'newton'\nforce_tolerance = 1e-16\nmax_iterations = 1_000_000_000\n",
    );
    let mut running = place.spawn(&RUN);
    running.until(|| place.path().join("out/results.h5.part").exists());
    running.signal("USR2");
    running.end().fails_with(85, &["ended by a signal", "out/checkpoint", "--resume"]);
}

fn ended_by(signal: &str) {
    let scene = INTERRUPTED[0].replace("128", "8192").replace("interval = 0", "interval = 1e9");
    let place = Place::in_memory(&scene);
    let mut running = place.spawn(&RUN);
    running.until(|| place.path().join("out/results.h5.part").exists());
    assert!(!place.path().join("out/checkpoint").exists());
    running.signal("USR1");
    running.until(|| place.path().join("out/checkpoint/scene.toml").exists());
    running.signal(signal);
    running.end().fails_with(85, &["ended by a signal", "out/checkpoint", "--resume"]);
    assert!(!checkpoint_files(place.path(), "").is_empty());
    let info = place.jamhpc(&["info", "out/results.h5.part"]).succeeds().stdout;
    assert!(info.contains("running, or killed before its end"), "{info}");
}

#[test]
fn a_run_keeps_its_folder_to_itself() {
    let place = Place::in_memory(&INTERRUPTED[0].replace("128", "8192"));
    let mut running = place.spawn(&RUN);
    running.until(|| place.path().join("out/checkpoint/scene.toml").exists());
    place.jamhpc(&RUN).is_refusal(&["out", "another run"]);
    running.signal("KILL");
    running.end();
    place.jamhpc(&RUN).is_refusal(&["out/checkpoint", "--resume"]);
}

#[test]
fn a_standard_output_that_takes_nothing_is_told_of() {
    let place = Place::with("scene.toml", QUICK_SP);
    let jamhpc = |arguments: &[&str]| place.command(env!("CARGO_BIN_EXE_jamhpc"), arguments);
    for arguments in [&["run", "scene.toml", "-o", "out"] as &[&str], &["info", "out/results.h5"]] {
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        let outcome = Outcome::from(jamhpc(arguments).stdout(full).output().unwrap());
        outcome.fails_with(1, &["the standard output", "No space left"]);
    }
    assert!(!place.path().join("out/checkpoint").exists(), "the run has come to its end");
    // a reader that has gone away does not want it
    let mut child = jamhpc(&["info", "out/results.h5"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    Outcome::from(child.wait_with_output().unwrap()).succeeds();
}

#[test]
fn a_full_disk_leaves_the_checkpoint_before() {
    let place = Place::in_memory(INTERRUPTED[0]);
    let undisturbed = Place::in_memory(INTERRUPTED[0]);
    undisturbed.jamhpc(&RUN).succeeds();
    let out = place.path().join("out");
    std::fs::create_dir(&out).unwrap();
    let mount = |options: &str| {
        let words = ["-t", "tmpfs", "-o", options, "tmpfs"];
        Command::new("mount").args(words).arg(&out).stderr(Stdio::null()).status().is_ok_and(|status| status.success())
    };
    if !mount("size=1200k") {
        return; // only root may
    }
    for ranks in [1, 2] {
        let arguments = if ranks == 1 { &RUN[..] } else { &RESUME };
        let failure = place.ranks(ranks, arguments);
        failure.fails_with(1, &["out/checkpoint/", "No space left", "free some space", "--resume"]);
        assert!(!checkpoint_files(place.path(), "done").is_empty());
    }
    assert!(mount("remount,size=16m"));
    place.ranks(2, &RESUME).succeeds();
    let same = place.read("out/results.h5") == undisturbed.read("out/results.h5");
    assert!(Command::new("umount").arg(&out).status().unwrap().success());
    assert!(same);
}
