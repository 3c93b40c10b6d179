//! Tables of results: as text, CSV, Markdown and JSON, all from the same numbers.

use serde::{Serialize, Serializer};
use serde_json::{Map, Value, json};

use super::Band;

/// The last column: what of a row agrees with the thesis.
pub const SAYS: &str = "against the thesis";

/// What stands in one place of a table.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// Words.
    Text(String),
    /// A number, and the digits behind its point that are shown.
    Number(f64, usize),
    /// Mean, and 10th and 90th percentile over seeds.
    Band(Band, usize),
    /// Nothing.
    Empty,
}

impl Cell {
    /// A whole number.
    pub fn count(value: usize) -> Self {
        Cell::Number(value as f64, 0)
    }

    /// Words.
    pub fn text(text: impl Into<String>) -> Self {
        Cell::Text(text.into())
    }

    /// A number, or nothing.
    pub fn maybe(value: Option<f64>, digits: usize) -> Self {
        value.map_or(Cell::Empty, |value| Cell::Number(value, digits))
    }

    /// A band, or nothing.
    pub fn band(band: Option<Band>, digits: usize) -> Self {
        band.map_or(Cell::Empty, |band| Cell::Band(band, digits))
    }

    fn is_number(&self) -> bool {
        !matches!(self, Cell::Text(_))
    }

    /// As it is read by a person.
    fn shown(&self) -> String {
        match self {
            Cell::Text(text) => text.clone(),
            Cell::Number(value, digits) => format!("{value:.digits$}"),
            Cell::Band(band, digits) if band.count == 1 => format!("{:.digits$}", band.mean),
            Cell::Band(band, digits) => {
                format!("{:.digits$} [{:.digits$}, {:.digits$}]", band.mean, band.low, band.high)
            }
            Cell::Empty => String::new(),
        }
    }
}

impl Serialize for Cell {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Cell::Text(text) => text.serialize(serializer),
            Cell::Number(value, _) => value.serialize(serializer),
            Cell::Band(band, _) => band.serialize(serializer),
            Cell::Empty => serializer.serialize_none(),
        }
    }
}

/// A table with named columns.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// What it shows.
    pub title: String,
    /// Names of the columns, with units; [`SAYS`] comes last. None before there is a row.
    pub columns: Vec<String>,
    rows: Vec<Vec<Cell>>,
}

impl Table {
    /// An empty table.
    pub fn new(title: impl Into<String>) -> Self {
        Table { title: title.into(), columns: Vec::new(), rows: Vec::new() }
    }

    /// Add a row, each cell with the name of its column, and say what of it agrees with the thesis.
    ///
    /// # Panics
    /// If the columns are not those of the rows before: a defect of the experiment.
    pub fn push<N: Into<String>>(&mut self, row: impl IntoIterator<Item = (N, Cell)>, says: impl Into<String>) {
        let row = row.into_iter().map(|(column, cell)| (column.into(), cell));
        let (columns, cells): (Vec<_>, _) = row.chain([(SAYS.to_owned(), Cell::text(says))]).unzip();
        assert!(self.rows.is_empty() || self.columns == columns, "a row of {}", self.title);
        self.columns = columns;
        self.rows.push(cells);
    }

    /// For a terminal: numbers right-aligned, words left-aligned.
    pub fn text(&self) -> String {
        let shown: Vec<Vec<String>> = self.rows.iter().map(|row| row.iter().map(Cell::shown).collect()).collect();
        let width = |column: usize| {
            let cells = shown.iter().map(|row| row[column].chars().count());
            cells.chain([self.columns[column].chars().count()]).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..self.columns.len()).map(width).collect();
        let right: Vec<bool> =
            (0..self.columns.len()).map(|column| self.rows.iter().all(|row| row[column].is_number())).collect();
        let line = |cells: &[String]| {
            let padded = cells.iter().zip(&widths).zip(&right).map(|((cell, &width), &right)| {
                if right { format!("{cell:>width$}") } else { format!("{cell:<width$}") }
            });
            padded.collect::<Vec<_>>().join("  ").trim_end().to_owned() + "\n"
        };
        let mut text = format!("{}\n{}", self.title, line(&self.columns));
        shown.iter().for_each(|row| text += &line(row));
        text
    }

    /// As Markdown.
    pub fn markdown(&self) -> String {
        let line = |cells: Vec<String>| {
            let cells: Vec<String> = cells.into_iter().map(|cell| cell.replace('|', "\\|")).collect();
            format!("| {} |\n", cells.join(" | "))
        };
        let rule = |column: usize| if self.rows.iter().all(|row| row[column].is_number()) { "---:" } else { "---" };
        let mut text = format!("**{}**\n\n{}", self.title, line(self.columns.clone()));
        text += &line((0..self.columns.len()).map(|column| rule(column).to_owned()).collect());
        self.rows.iter().for_each(|row| text += &line(row.iter().map(Cell::shown).collect()));
        text
    }

    /// As comma-separated values in full precision; bands become three columns.
    pub fn csv(&self) -> String {
        let bands: Vec<bool> = (0..self.columns.len())
            .map(|column| self.rows.iter().any(|row| matches!(row[column], Cell::Band(..))))
            .collect();
        let quoted = |text: &str| {
            if text.contains([',', '"', '\n']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
        };
        let mut head = Vec::new();
        for (name, &band) in self.columns.iter().zip(&bands) {
            head.push(quoted(name));
            if band {
                head.extend(["p10", "p90"].map(|end| quoted(&format!("{name}, {end}"))));
            }
        }
        let mut text = head.join(",") + "\n";
        for row in &self.rows {
            let mut line = Vec::new();
            for (cell, &band) in row.iter().zip(&bands) {
                match cell {
                    Cell::Band(band, _) => line.extend([band.mean, band.low, band.high].map(|value| value.to_string())),
                    other => {
                        line.push(match other {
                            Cell::Number(value, _) => value.to_string(),
                            other => quoted(&other.shown()),
                        });
                        if band {
                            line.extend([String::new(), String::new()]);
                        }
                    }
                }
            }
            text += &(line.join(",") + "\n");
        }
        text
    }

    /// As JSON: a list of rows, each with the columns as keys.
    pub fn json(&self) -> Value {
        let row = |cells: &Vec<Cell>| {
            let entries = self.columns.iter().zip(cells).map(|(name, cell)| (name.clone(), json!(cell)));
            Value::Object(entries.collect::<Map<_, _>>())
        };
        json!({ "title": self.title, "columns": self.columns, "rows": self.rows.iter().map(row).collect::<Vec<_>>() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let mut table = Table::new("Steps, by features");
        let row = |features, steps, thesis| {
            [("features", Cell::count(features)), ("steps", steps), ("thesis: steps", thesis)]
        };
        let band = Band::of([1.0, 2.0, 3.0]).unwrap();
        table.push(row(10, Cell::Band(band, 1), Cell::Empty), "not in the thesis");
        table.push(row(200, Cell::Number(0.5, 2), Cell::text("< 1")), "agrees, | below 1");
        table
    }

    #[test]
    fn all_forms_show_the_same_numbers() {
        let table = table();
        let text = table.text();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[2], "      10  2.0 [1.2, 2.8]                 not in the thesis");
        assert_eq!(lines[3], "     200            0.50  < 1            agrees, | below 1");
        assert!(table.markdown().contains("| 200 | 0.50 | < 1 | agrees, \\| below 1 |"));
        assert!(
            table.csv().starts_with("features,steps,\"steps, p10\",\"steps, p90\",thesis: steps,against the thesis\n")
        );
        assert!(table.csv().contains("200,0.5,,,< 1,\"agrees, | below 1\"\n"));
        let json = table.json();
        assert_eq!(json["rows"][0]["steps"]["mean"], 2.0);
        assert_eq!(json["rows"][1]["steps"], 0.5);
        assert!(json["rows"][0]["thesis: steps"].is_null());
    }
}
