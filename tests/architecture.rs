//! The rules of ARCHITECTURE.md that a compiler does not check: which room of `src/` may use which, and what some of
//! them must not mention.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Room, and the rooms it may use. Every room (folder or file of `src/`) stands here.
const MAY_USE: &[(&str, &[&str])] = &[
    ("geometry", &[]),
    ("statistics", &[]),
    ("lanes", &["geometry"]),
    ("threads", &[]),
    ("allocator", &[]),
    ("profile", &[]),
    ("particles", &["geometry", "threads"]),
    ("decomposition", &["geometry"]),
    ("neighbor", &["geometry", "lanes", "particles", "threads"]),
    ("model", &["geometry", "lanes", "particles", "neighbor"]),
    ("comm", &["allocator", "threads", "profile", "decomposition", "particles"]),
    (
        "engine",
        &["geometry", "allocator", "particles", "threads", "profile", "decomposition", "neighbor", "model", "comm"],
    ),
    ("stiffness", &["geometry", "particles", "threads", "model", "comm", "engine"]),
    ("minimize", &["geometry", "lanes", "particles", "threads", "model", "comm", "engine", "stiffness"]),
    ("protocol", &["geometry", "particles", "model", "comm", "engine", "minimize"]),
    ("observe", &["geometry", "particles", "threads", "neighbor", "model", "comm", "engine", "stiffness", "minimize"]),
    ("validate", &["geometry", "particles", "model", "comm", "engine", "minimize", "protocol", "observe"]),
    ("output", &["geometry", "particles", "comm", "observe"]),
    ("exchange", &["geometry", "particles", "model", "comm", "engine", "minimize", "protocol", "observe"]),
    ("scene", &[]),
    // the edge, where everything is put together
    ("failure", &["engine", "exchange", "output", "protocol", "scene"]),
    ("costs", &["profile", "comm"]),
    ("study", ANY),
    ("run", ANY),
    ("frames", ANY),
    ("analysis", ANY),
    ("cli", ANY),
    ("commands", ANY),
    ("lib", ANY),
    ("main", ANY),
];
const ANY: &[&str] = &["*"];

struct Source {
    path: PathBuf,
    room: String,
    /// Without comments and the text of strings.
    code: String,
}

fn sources() -> Vec<Source> {
    fn collect(dir: &Path, into: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(dir).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                collect(&path, into);
            } else if path.extension().is_some_and(|e| e == "rs") {
                into.push(path);
            }
        }
    }
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut paths = Vec::new();
    collect(&src, &mut paths);
    let source = |path: PathBuf| {
        let inside = path.strip_prefix(&src).unwrap();
        let room = Path::new(inside.components().next().unwrap().as_os_str()).file_stem().unwrap();
        let room = room.to_str().unwrap().to_string();
        let text = fs::read_to_string(&path).unwrap();
        Source { path, room, code: code_of(&text) }
    };
    let all: Vec<Source> = paths.into_iter().map(source).collect();
    assert!(all.len() > 20, "the sources are elsewhere");
    all
}

/// What is left of a file without comments and the text of strings, line by line.
fn code_of(text: &str) -> String {
    let mut code = String::new();
    let mut in_string = false;
    for line in text.lines() {
        let mut rest = line.chars().peekable();
        while let Some(c) = rest.next() {
            match c {
                '\\' if in_string => drop(rest.next()),
                '"' if code.ends_with("b'") || code.ends_with('\'') => (), // a quote as a character
                '"' => in_string = !in_string,
                '/' if !in_string && rest.peek() == Some(&'/') => break,
                _ if in_string => (),
                _ => code.push(c),
            }
        }
        code.push('\n');
    }
    code
}

fn is_name(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// The identifiers of a piece of code.
fn names(code: &str) -> impl Iterator<Item = &str> {
    code.split(|c| !is_name(c)).filter(|name| !name.is_empty())
}

/// Rooms named after `crate::`, in `use` lines and elsewhere, single or in braces.
fn used_rooms(code: &str) -> BTreeSet<&str> {
    let mut rooms = BTreeSet::new();
    for rest in code.split("crate::").skip(1) {
        match rest.strip_prefix('{') {
            None => rooms.extend(names(rest).next()),
            Some(list) => {
                // the names at the first level of the braces
                let mut depth = 0;
                for item in list.split_inclusive([',', '{', '}']) {
                    if depth == 0 {
                        rooms.extend(names(item).next());
                    }
                    match item.chars().last() {
                        Some('{') => depth += 1,
                        Some('}') => depth -= 1,
                        _ => (),
                    }
                    if depth < 0 {
                        break;
                    }
                }
            }
        }
    }
    rooms
}

#[test]
fn rooms_use_only_those_below() {
    let mut broken = Vec::new();
    for source in sources() {
        let Some((_, allowed)) = MAY_USE.iter().find(|(room, _)| *room == source.room) else {
            broken.push(format!("{}: room '{}' is not in the table", source.path.display(), source.room));
            continue;
        };
        for used in used_rooms(&source.code) {
            let is_room = MAY_USE.iter().any(|(room, _)| *room == used);
            if is_room && used != source.room && *allowed != ANY && !allowed.contains(&used) {
                broken.push(format!("{}: {} must not use {used}", source.path.display(), source.room));
            }
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn the_table_is_a_hierarchy() {
    for (i, (room, allowed)) in MAY_USE.iter().enumerate() {
        for used in *allowed {
            let above = MAY_USE[i..].iter().any(|(other, _)| other == used);
            assert!(!above, "{room} uses {used}, which stands at or after it: rooms use downward only");
        }
    }
}

/// Panics if a file of one of `rooms` contains one of `words` as an identifier (case ignored) or macro.
fn assert_absent(rooms: &[&str], words: &[&str], why: &str) {
    let mut broken = Vec::new();
    for source in sources().iter().filter(|s| rooms.contains(&s.room.as_str())) {
        for (number, line) in source.code.lines().enumerate() {
            // parts of snake_case and CamelCase identifiers count as words
            let parts = names(line).flat_map(parts_of_name);
            if let Some(word) = parts.into_iter().find(|part| words.contains(&part.as_str())) {
                broken.push(format!("{}:{}: '{word}' in: {}", source.path.display(), number + 1, line.trim()));
            }
        }
    }
    assert!(broken.is_empty(), "{why}\n{}", broken.join("\n"));
}

/// `max_rank` → max, rank; `SoftDisks` → soft, disks; `MPI_Comm` → mpi, comm.
fn parts_of_name(name: &str) -> Vec<String> {
    let mut parts = vec![String::new()];
    let mut before = ' ';
    for c in name.chars() {
        if c == '_' || (c.is_uppercase() && !before.is_uppercase()) {
            parts.push(String::new());
        }
        if c != '_' {
            parts.last_mut().unwrap().extend(c.to_lowercase());
        }
        before = c;
    }
    parts.retain(|part| !part.is_empty());
    parts
}

#[test]
fn potentials_never_hear_of_ranks() {
    let words = ["rank", "ranks", "mpi", "comm", "halo", "ghost", "ghosts", "peer", "peers", "migrate", "subdomain"];
    assert_absent(&["model", "neighbor", "geometry"], &words, "only the engine brings potentials and ranks together");
}

#[test]
fn communication_never_hears_of_potentials() {
    let words =
        ["model", "potential", "energy", "epsilon", "delta", "tension", "disks", "deformable", "contact", "force"];
    assert_absent(&["comm", "decomposition"], &words, "messages are words in buffers, whatever they mean");
}

#[test]
fn only_comm_knows_mpi() {
    // output hands the raw communicator to HDF5, through comm
    let rooms: Vec<&str> = MAY_USE.iter().map(|(room, _)| *room).filter(|r| !["comm", "output"].contains(r)).collect();
    assert_absent(&rooms, &["mpi"], "MPI is called in one room");
}

#[test]
fn protocols_do_no_input_or_output() {
    let words = ["fs", "io", "print", "println", "eprint", "eprintln", "file", "stdout", "stderr", "path"];
    assert_absent(&["protocol", "minimize", "engine", "model"], &words, "protocols answer with values");
}

#[test]
fn unsafe_code_stays_at_the_edges() {
    // lanes: instructions that only some processors have
    let edges = ["comm", "output", "lanes", "allocator"];
    let rooms: Vec<&str> = MAY_USE.iter().map(|(room, _)| *room).filter(|r| !edges.contains(r)).collect();
    assert_absent(&rooms, &["unsafe"], "only foreign interfaces and processor instructions need it");
}

#[test]
fn the_checks_see_what_they_look_for() {
    let found = used_rooms("use crate::{comm::{Comm, model}, engine};\nlet x = crate::geometry::norm(a);");
    assert_eq!(found, BTreeSet::from(["comm", "engine", "geometry"]));
    assert_eq!(code_of("let a = \"rank \\\" // one\"; // rank\nb"), "let a = ; \nb\n");
    assert_eq!(parts_of_name("MPI_Comm"), ["mpi", "comm"]);
    assert_eq!(parts_of_name("maxRank_of"), ["max", "rank", "of"]);
}
