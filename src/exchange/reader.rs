use super::Problem;
use crate::geometry::Vec2;
use serde_json::{Map, Value};

/// Numbers that a key accepts. The bounds keep every product of a few of them finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Range {
    Positive,
    NotNegative,
    Any,
}

const SMALLEST: f64 = 1e-30;
const LARGEST: f64 = 1e30;

impl Range {
    fn holds(self, x: f64) -> bool {
        match self {
            Range::Positive => (SMALLEST..=LARGEST).contains(&x),
            Range::NotNegative => (0.0..=LARGEST).contains(&x),
            Range::Any => x.abs() <= LARGEST,
        }
    }

    fn text(self) -> &'static str {
        match self {
            Range::Positive => "a number greater than 0 (1e-30 to 1e30)",
            Range::NotNegative => "a number not below 0 (at most 1e30)",
            Range::Any => "a finite number (at most 1e30 in magnitude)",
        }
    }
}

/// An object of the text: answers by key, with errors that name the key by its path.
pub struct Object<'a> {
    map: &'a Map<String, Value>,
    /// Path of the object with a dot behind it, or nothing at the top.
    path: &'static str,
}

impl<'a> Object<'a> {
    /// The object, if it has no other keys than `known`.
    pub fn new(map: &'a Map<String, Value>, path: &'static str, known: &[&str]) -> Result<Self, Problem> {
        match map.keys().find(|key| !known.contains(&key.as_str())) {
            None => Ok(Object { map, path }),
            Some(key) => {
                let nearest = known.iter().map(|k| (distance(key, k), k)).min();
                let hint = match nearest {
                    Some((d, k)) if d <= 1 + k.len() / 3 && d < k.len() => format!(", did you mean `{path}{k}`?"),
                    _ => String::new(),
                };
                Err(Problem::UnknownKey { key: shown(&format!("{path}{key}")), hint, known: known.join(", ") })
            }
        }
    }

    /// The object at the top, whatever its keys.
    pub fn unchecked(map: &'a Map<String, Value>) -> Self {
        Object { map, path: "" }
    }

    pub fn has(&self, key: &str) -> bool {
        self.map.contains_key(key)
    }

    fn path(&self, key: &str) -> String {
        format!("{}{key}", self.path)
    }

    fn value(&self, key: &str, expected: &str) -> Result<&'a Value, Problem> {
        self.map.get(key).ok_or_else(|| Problem::Missing { key: self.path(key), expected: expected.to_string() })
    }

    fn list(&self, key: &str, expected: &str) -> Result<&'a [Value], Problem> {
        let value = self.value(key, expected)?;
        value.as_array().map(Vec::as_slice).ok_or_else(|| wrong(self.path(key), expected, value))
    }

    pub fn object(&self, key: &str, path: &'static str, known: &[&str]) -> Result<Object<'a>, Problem> {
        let expected = format!("an object with the keys {}", known.join(", "));
        let value = self.value(key, &expected)?;
        let map = value.as_object().ok_or_else(|| wrong(self.path(key), &expected, value))?;
        Object::new(map, path, known)
    }

    /// One of a few words.
    pub fn word(&self, key: &str, accepted: &[&str]) -> Result<&'a str, Problem> {
        let expected = accepted.iter().map(|word| format!("\"{word}\"")).collect::<Vec<_>>().join(" or ");
        let value = self.value(key, &expected)?;
        let word = value.as_str().filter(|word| accepted.contains(word));
        word.ok_or_else(|| wrong(self.path(key), &expected, value))
    }

    pub fn number(&self, key: &str, range: Range) -> Result<f64, Problem> {
        number(self.value(key, range.text())?, || self.path(key), range)
    }

    /// A list of numbers, at least one.
    pub fn numbers(&self, key: &str, range: Range) -> Result<Vec<f64>, Problem> {
        let list = self.list(key, &format!("a list with {} for each particle", range.text()))?;
        let at = |(i, value): (usize, &Value)| number(value, || format!("{}[{i}]", self.path(key)), range);
        list.iter().enumerate().map(at).collect()
    }

    /// A list of whole numbers of vertices.
    pub fn vertex_counts(&self, key: &str) -> Result<Vec<u32>, Problem> {
        let list = self.list(key, "a list with the number of vertices of each particle")?;
        let count = |(i, value): (usize, &Value)| {
            let n = value.as_u64().filter(|n| (3..=1_000_000).contains(n)).map(|n| n as u32);
            n.ok_or_else(|| wrong(format!("{}[{i}]", self.path(key)), "a whole number from 3 to 1000000", value))
        };
        list.iter().enumerate().map(count).collect()
    }

    /// A list of points [x, y].
    pub fn points(&self, key: &str) -> Result<Vec<Vec2>, Problem> {
        let list = self.list(key, "a list of points [x, y]")?;
        let point = |(i, value): (usize, &Value)| match value.as_array().map(Vec::as_slice) {
            Some([x, y]) => {
                let at = |k: usize| format!("{}[{i}][{k}]", self.path(key));
                Ok([number(x, || at(0), Range::Any)?, number(y, || at(1), Range::Any)?])
            }
            _ => Err(wrong(format!("{}[{i}]", self.path(key)), "a point [x, y]", value)),
        };
        list.iter().enumerate().map(point).collect()
    }
}

fn number(value: &Value, key: impl Fn() -> String, range: Range) -> Result<f64, Problem> {
    value.as_f64().filter(|&x| range.holds(x)).ok_or_else(|| wrong(key(), range.text(), value))
}

pub fn wrong(key: String, expected: &str, value: &Value) -> Problem {
    let got = match value {
        Value::Null => "null (a number that is not finite?)".to_string(),
        Value::Bool(b) => b.to_string(),
        Value::Number(x) => x.to_string(),
        Value::String(text) => format!("\"{}\"", shown(text)),
        Value::Array(items) => format!("a list of {}", items.len()),
        Value::Object(_) => "an object".to_string(),
    };
    Problem::Wrong { key, expected: expected.to_string(), got }
}

/// A text that may be long, on one short line.
fn shown(text: &str) -> String {
    let line = text.replace(char::is_control, " ");
    if line.chars().count() <= 60 { line } else { line.chars().take(57).chain("...".chars()).collect() }
}

/// Least number of letters to insert, delete or replace that turns one word into the other.
fn distance(a: &str, b: &str) -> usize {
    let mut row: Vec<usize> = (0..=b.chars().count()).collect();
    for (i, x) in a.chars().take(100).enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.chars().enumerate() {
            let replaced = diagonal + usize::from(x != y);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[row.len() - 1]
}
