//! One line a check.

use super::Check;

/// The names of the columns, line ended.
pub fn header() -> String {
    format!("{:<52} {:>13} {:>13} {:>8} {:>9}  pass\n", "check", "expected", "got", "error", "tolerance")
}

/// The line of one check, ended.
pub fn line(check: &Check) -> String {
    let Check { name, expected, got, tolerance, .. } = check;
    let pass = if check.passes() { "yes" } else { "NO" };
    format!("{name:<52} {expected:>13.8} {got:>13.8} {:>8.1e} {tolerance:>9.1e}  {pass}\n", check.error())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_line_up() {
        let check = Check::new("SP lattice f = 0.99: z", 6.0, 6.5, 1e-12);
        let text = line(&check);
        assert_eq!(text.find("NO"), header().find("pass"), "{text}{}", header());
        assert!(text.contains("6.00000000    6.50000000   8.3e-2   1.0e-12"), "{text}");
    }
}
