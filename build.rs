//! Tells the crate which commit it is built from, for the results files: `JAMHPC_GIT_HASH`, "unknown" without git.

use std::path::Path;
use std::process::Command;

fn main() {
    let root = std::env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    let git = |arguments: &[&str]| {
        let output = Command::new("git").arg("-C").arg(&root).args(arguments).output().ok()?;
        let text = String::from_utf8(output.stdout).ok()?.trim().to_owned();
        (output.status.success() && !text.is_empty()).then_some(text)
    };
    // an unpacked archive inside somebody else's repository has no commit of its own
    let ours = Path::new(&root).join(".git").exists();
    let hash = if ours { git(&["describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]) } else { None };
    println!("cargo:rustc-env=JAMHPC_GIT_HASH={}", hash.unwrap_or_else(|| "unknown".to_owned()));

    for path in ["build.rs", "src", "Cargo.toml"] {
        println!("cargo:rerun-if-changed={path}");
    }
    for name in ["HEAD", "logs/HEAD"] {
        if let Some(path) = git(&["rev-parse", "--git-path", name]).filter(|_| ours) {
            let path = Path::new(&root).join(path);
            if path.exists() {
                println!("cargo:rerun-if-changed={}", path.display());
            }
        }
    }
}
