/// A part of a piece of outline that lies inside something else.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hidden {
    pub from: f64,
    pub to: f64,
    /// Global id of the particle that hides it.
    pub by: u32,
}

/// A part of a piece that nothing hides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposed {
    pub from: f64,
    pub to: f64,
    /// What hides the piece before this part; none where it reaches the start of the piece.
    pub after: Option<u32>,
    /// What hides the piece behind this part; none where it reaches the end of the piece.
    pub before: Option<u32>,
}

/// What is left of one piece of outline.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Exposure {
    pub parts: Vec<Exposed>,
    /// What hides the start of the piece, and its end.
    pub start_hidden_by: Option<u32>,
    pub end_hidden_by: Option<u32>,
}

impl Exposure {
    /// The complement of the hidden parts in 0 … `extent`. They are sorted on the way.
    pub fn of(hidden: &mut [Hidden], extent: f64) -> Exposure {
        hidden.sort_unstable_by(|a, b| a.from.total_cmp(&b.from).then(a.to.total_cmp(&b.to)).then(a.by.cmp(&b.by)));
        let mut exposure = Exposure::default();
        let (mut reached, mut by) = (0.0, None);
        for part in hidden.iter() {
            if part.from > reached {
                exposure.parts.push(Exposed { from: reached, to: part.from, after: by, before: Some(part.by) });
            } else if exposure.parts.is_empty() && by.is_none() {
                exposure.start_hidden_by = Some(part.by);
            }
            if part.to > reached {
                (reached, by) = (part.to, Some(part.by));
            }
        }
        if reached < extent {
            exposure.parts.push(Exposed { from: reached, to: extent, after: by, before: None });
        } else {
            exposure.end_hidden_by = by;
        }
        exposure
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hidden(parts: &[(f64, f64, u32)]) -> Vec<Hidden> {
        parts.iter().map(|&(from, to, by)| Hidden { from, to, by }).collect()
    }

    #[test]
    fn nothing_and_everything_hidden() {
        let free = Exposure::of(&mut [], 2.0);
        assert_eq!(free.parts, [Exposed { from: 0.0, to: 2.0, after: None, before: None }]);
        assert_eq!((free.start_hidden_by, free.end_hidden_by), (None, None));
        let gone = Exposure::of(&mut hidden(&[(1.0, 2.0, 4), (0.0, 1.5, 3)]), 2.0);
        assert_eq!((gone.parts.len(), gone.start_hidden_by, gone.end_hidden_by), (0, Some(3), Some(4)));
    }

    #[test]
    fn parts_know_their_neighbors() {
        let some = Exposure::of(&mut hidden(&[(1.0, 1.2, 7), (0.0, 0.5, 5), (1.1, 1.4, 8), (0.2, 0.3, 6)]), 2.0);
        let part = |from, to, after, before| Exposed { from, to, after, before };
        assert_eq!(some.parts, [part(0.5, 1.0, Some(5), Some(7)), part(1.4, 2.0, Some(8), None)]);
        assert_eq!((some.start_hidden_by, some.end_hidden_by), (Some(5), None));
    }
}
