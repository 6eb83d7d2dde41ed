//! Tables in an HDF5 file: groups of named columns, and texts as attributes. Written whole or not at all. For one rank.
//!
//! ```text
//! /            attributes: texts by name
//! /TABLE/NAME  one column, [rows]
//! ```

use super::error::OutputError;
use super::folder::explain;
use super::h5md::access;
use crate::comm::Comm;
use hdf5::types::{TypeDescriptor, VarLenUnicode};
use hdf5::{Dataset, File, Group, H5Type};
use std::path::Path;

/// The values of one column; a number that is not there is NaN.
#[derive(Clone, Debug, PartialEq)]
pub enum Column {
    Numbers(Vec<f64>),
    Counts(Vec<u64>),
    Texts(Vec<String>),
}

/// Columns of equal length, in any order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    pub name: String,
    pub columns: Vec<(String, Column)>,
}

impl Table {
    pub fn new(name: &str, columns: Vec<(&str, Column)>) -> Self {
        let columns = columns.into_iter().map(|(name, column)| (name.to_owned(), column)).collect();
        Table { name: name.to_owned(), columns }
    }

    fn column(&self, name: &str) -> Option<&Column> {
        self.columns.iter().find(|(n, _)| n == name).map(|(_, column)| column)
    }

    /// A column of numbers; none if it is absent or of another kind.
    pub fn numbers(&self, name: &str) -> Option<&[f64]> {
        if let Some(Column::Numbers(values)) = self.column(name) { Some(values) } else { None }
    }

    /// A column of whole numbers.
    pub fn counts(&self, name: &str) -> Option<&[u64]> {
        if let Some(Column::Counts(values)) = self.column(name) { Some(values) } else { None }
    }

    /// A column of texts.
    pub fn texts(&self, name: &str) -> Option<&[String]> {
        if let Some(Column::Texts(values)) = self.column(name) { Some(values) } else { None }
    }
}

/// Texts by name, and tables.
pub type Contents = (Vec<(String, String)>, Vec<Table>);

/// Replaces the file at once: an older one stays until the new one is on the disk.
pub fn write_tables(path: &Path, texts: &[(&str, &str)], tables: &[Table]) -> Result<(), OutputError> {
    let part = path.with_extension("h5.part");
    let publish = || -> std::io::Result<()> {
        std::fs::File::open(&part)?.sync_all()?;
        std::fs::rename(&part, path)?;
        let folder = path.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
        std::fs::File::open(folder)?.sync_all()
    };
    let written = try_write(&part, texts, tables).map_err(|e| e.to_string());
    written.and_then(|()| publish().map_err(|e| explain(&e))).map_err(|reason| {
        let _ = std::fs::remove_file(&part); // it may never have come to be
        OutputError::write(path, reason)
    })
}

fn try_write(part: &Path, texts: &[(&str, &str)], tables: &[Table]) -> hdf5::Result<()> {
    let file = File::with_options().set_fapl(&access(&Comm::alone())?)?.create(part)?;
    for (name, text) in texts {
        file.new_attr::<VarLenUnicode>().create(*name)?.write_scalar(&unicode(text)?)?;
    }
    for table in tables {
        let group = file.create_group(&table.name)?;
        for (name, column) in &table.columns {
            match column {
                Column::Numbers(values) => write_column(&group, name, values)?,
                Column::Counts(values) => write_column(&group, name, values)?,
                Column::Texts(values) => {
                    let values = values.iter().map(|text| unicode(text)).collect::<hdf5::Result<Vec<_>>>()?;
                    write_column(&group, name, &values)?;
                }
            }
        }
    }
    file.flush()?;
    file.close()
}

fn unicode(text: &str) -> hdf5::Result<VarLenUnicode> {
    text.parse().map_err(|e| format!("text: {e}").into())
}

fn write_column<T: H5Type>(group: &Group, name: &str, values: &[T]) -> hdf5::Result<()> {
    let dataset = group.new_dataset::<T>().obj_track_times(false).shape([values.len()]).create(name)?;
    if values.is_empty() { Ok(()) } else { dataset.write(values) }
}

/// All texts and tables of a file; columns in the order of their names.
pub fn read_tables(path: &Path) -> Result<Contents, OutputError> {
    std::fs::File::open(path).map_err(|e| OutputError::read(path, explain(&e)))?;
    try_read(path).map_err(|e| OutputError::read(path, e))
}

fn try_read(path: &Path) -> hdf5::Result<Contents> {
    let file = File::with_options().set_fapl(&access(&Comm::alone())?)?.open(path)?;
    let mut texts = Vec::new();
    for name in file.attr_names()? {
        let text: VarLenUnicode = file.attr(&name)?.read_scalar()?;
        texts.push((name, text.as_str().to_owned()));
    }
    let mut tables = Vec::new();
    for name in file.member_names()? {
        let group = file.group(&name)?;
        let columns = group.member_names()?.into_iter().map(|name| {
            let column = read_column(&group.dataset(&name)?)?;
            Ok((name, column))
        });
        tables.push(Table { columns: columns.collect::<hdf5::Result<_>>()?, name });
    }
    Ok((texts, tables))
}

fn read_column(dataset: &Dataset) -> hdf5::Result<Column> {
    match dataset.dtype()?.to_descriptor()? {
        TypeDescriptor::Float(_) => Ok(Column::Numbers(dataset.read_raw()?)),
        TypeDescriptor::Unsigned(_) => Ok(Column::Counts(dataset.read_raw()?)),
        TypeDescriptor::VarLenUnicode => {
            let texts: Vec<VarLenUnicode> = dataset.read_raw()?;
            Ok(Column::Texts(texts.iter().map(|text| text.as_str().to_owned()).collect()))
        }
        other => Err(format!("{}: columns of type {other} are not known", dataset.name()).into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_come_back_and_are_the_same_bytes() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("t.h5");
        let table = Table::new(
            "rows",
            vec![
                ("a", Column::Numbers(vec![0.1, f64::MIN_POSITIVE, -3.0])),
                ("b", Column::Counts(vec![1, 2, u64::MAX])),
                ("c", Column::Texts(vec!["".into(), "ρ_J\nμ".into(), "x".repeat(5000)])),
            ],
        );
        let empty = Table::new("void", vec![("a", Column::Numbers(vec![])), ("c", Column::Texts(vec![]))]);
        let tables = [table, empty];
        write_tables(&path, &[("study", "text")], &tables).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(read_tables(&path).unwrap(), (vec![("study".into(), "text".into())], tables.to_vec()));
        write_tables(&path, &[("study", "text")], &tables).unwrap();
        assert!(bytes == std::fs::read(&path).unwrap());
        assert_eq!(std::fs::read_dir(home.path()).unwrap().count(), 1);
        assert_eq!(tables[0].counts("b").unwrap()[1], 2);
        assert_eq!(tables[0].numbers("b"), None);
    }

    #[test]
    fn other_files_are_refused() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("t.h5");
        assert!(read_tables(&path).unwrap_err().to_string().contains("t.h5"));
        std::fs::write(&path, "x").unwrap();
        assert!(read_tables(&path).is_err());
    }
}
