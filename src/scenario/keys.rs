//! Reading a TOML file key by key: each key is declared once, with its unit, default, allowed range and meaning.
//!
//! One declaration does four things: it reads the value (or the default), it collects a fault with line, key, value
//! and range if the value is not allowed, it marks the key as known, and it writes the key into the complete file that a
//! run keeps. Reading never stops at a fault, so all faults of a file are reported at once.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Keys that had another name in the version before: the name of today, and the old one. A file may still use those.
const RENAMED: [(&str, &str); 4] = [
    ("world.texture_seed", "papers"),
    ("policy.explore_length", "explore_leg"),
    ("policy.pursue_timeout", "pursue_leg"),
    ("agent.snapshot_minutes", "keep_minutes"),
];

/// One thing that is wrong with a scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct Fault {
    /// Line of the file, from 1; `None` for `--set` and for keys that are missing.
    pub line: Option<usize>,
    /// The key with its section, or empty.
    pub key: String,
    /// What is wrong: the value, and what is allowed.
    pub text: String,
}

/// Allowed values of a number.
#[derive(Debug, Clone, Copy)]
pub struct Range {
    low: f64,
    high: f64,
    low_open: bool,
}

/// `low ≤ value ≤ high`.
pub const fn within(low: f64, high: f64) -> Range {
    Range { low, high, low_open: false }
}

/// `low < value ≤ high`.
pub const fn above(low: f64, high: f64) -> Range {
    Range { low, high, low_open: true }
}

impl Range {
    fn holds(&self, value: f64) -> bool {
        value.is_finite() && value <= self.high && (value > self.low || !self.low_open && value == self.low)
    }
}

impl std::fmt::Display for Range {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}{}, {}]", if self.low_open { "(" } else { "[" }, self.low, self.high)
    }
}

/// A file that is being read.
pub struct Reader<'t> {
    text: &'t str,
    root: Spanned<DeTable<'t>>,
    overrides: BTreeMap<String, Override<'t>>,
    /// Everything that is wrong so far.
    pub faults: Vec<Fault>,
    /// Old names of keys that were used.
    pub notes: Vec<String>,
    /// The complete file.
    written: String,
    lines: BTreeMap<String, Option<usize>>,
}

struct Override<'t> {
    value: DeValue<'t>,
    used: bool,
}

impl<'t> Reader<'t> {
    /// Parse a TOML text and `KEY=VALUE` overrides. Broken TOML gives faults; what could be read is read.
    pub fn new(text: &'t str, sets: &'t [String]) -> Self {
        let (root, errors) = DeTable::parse_recoverable(text);
        let mut faults: Vec<Fault> = errors
            .iter()
            .map(|error| Fault {
                line: error.span().map(|span| line_of(text, span.start)),
                key: String::new(),
                text: format!("broken TOML: {}", error.message()),
            })
            .collect();
        let mut overrides = BTreeMap::new();
        for set in sets {
            let Some((key, value)) = set.split_once('=') else {
                faults.push(Fault {
                    line: None,
                    key: set.clone(),
                    text: "is not KEY=VALUE, such as dictionary.nu=0.01".into(),
                });
                continue;
            };
            // A bare word is taken as a string, so that a shell needs no second pair of quotes.
            let value = value.trim();
            let value = DeValue::parse(value).map_or_else(|_| DeValue::String(value.into()), Spanned::into_inner);
            overrides.insert(key.trim().to_owned(), Override { value, used: false });
        }
        Reader { text, root, overrides, faults, notes: Vec::new(), written: String::new(), lines: BTreeMap::new() }
    }

    /// Read one section; `path` is dotted (`"world.floor"`), empty for the top of the file.
    pub fn section<R>(&mut self, path: &str, doc: &str, read: impl FnOnce(&mut Section<'_, 't>) -> R) -> R {
        self.at(path, &format!("[{path}]"), doc, read)
    }

    /// Read a list of sections (`[[task]]`), each with `read`; the second argument is its number from 0.
    pub fn sections<R>(
        &mut self,
        path: &str,
        doc: &str,
        mut read: impl FnMut(&mut Section<'_, 't>, usize) -> R,
    ) -> Vec<R> {
        let count = match find(self.root.get_ref(), path) {
            None => 0,
            Some(value) => match value.get_ref() {
                DeValue::Array(list) => list.len(),
                other => {
                    let line = Some(line_of(self.text, value.span().start));
                    let text = format!("is of type {}: allowed is a list of sections, [[{path}]]", other.type_str());
                    self.faults.push(Fault { line, key: path.into(), text });
                    0
                }
            },
        };
        (0..count)
            .map(|index| self.at(&format!("{path}.{index}"), &format!("[[{path}]]"), doc, |s| read(s, index)))
            .collect()
    }

    fn at<R>(&mut self, path: &str, title: &str, doc: &str, read: impl FnOnce(&mut Section<'_, 't>) -> R) -> R {
        if !path.is_empty() {
            let _ = write!(self.written, "\n{title}");
            let _ = writeln!(self.written, "{}", if doc.is_empty() { String::new() } else { format!("  # {doc}") });
        }
        let mut section = Section { reader: self, path: path.to_owned(), known: Vec::new() };
        let result = read(&mut section);
        section.report_unknown();
        result
    }

    /// Whether none of some keys, nor anything below them, has a fault: only then can their values be compared.
    pub fn sound(&self, keys: &[&str]) -> bool {
        let concerns = |fault: &Fault, key: &str| {
            fault.key.strip_prefix(key).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
        };
        !self.faults.iter().any(|fault| keys.iter().any(|key| concerns(fault, key)))
    }

    /// Report a section that the scenario has no use for, if it is there.
    pub fn refuse_section(&mut self, path: &str, why: &str) {
        if let Some(value) = find(self.root.get_ref(), path) {
            let line = Some(line_of(self.text, value.span().start));
            self.faults.push(Fault { line, key: path.to_owned(), text: why.to_owned() });
        }
    }

    /// Report a fault that was found later at a key that was read.
    pub fn fault_at(&mut self, key: &str, text: String) {
        let line = self.lines.get(key).copied().flatten();
        self.faults.push(Fault { line, key: key.to_owned(), text });
    }

    /// All faults in the order of their lines, and the complete file.
    pub fn finish(mut self) -> (Vec<Fault>, String) {
        for (key, set) in &self.overrides {
            // Before anything was read, nothing can be said of overrides.
            if !set.used && !self.written.is_empty() {
                self.faults.push(Fault { line: None, key: key.clone(), text: "in --set is not a key".into() });
            }
        }
        self.faults.sort_by_key(|fault| fault.line.unwrap_or(usize::MAX));
        (self.faults, self.written)
    }
}

/// One section of the file.
pub struct Section<'r, 't> {
    reader: &'r mut Reader<'t>,
    path: String,
    known: Vec<String>,
}

/// What a key held: the value and where it stands.
enum Found<'t> {
    Nothing,
    Value(DeValue<'t>, Option<usize>),
}

impl<'t> Section<'_, 't> {
    /// A real number with a unit.
    pub fn number(&mut self, key: &str, default: f64, unit: &str, range: Range, doc: &str) -> f64 {
        let found = self.take(key);
        self.number_in(key, found, default, unit, range, doc)
    }

    /// A share of `whole`. The version before gave it as a whole number, with the name `old`.
    pub fn share_of(&mut self, key: &str, whole: usize, old: &str, default: f64, doc: &str) -> f64 {
        let name = self.name(key);
        let found = self.take_as(key, &name);
        let old = if let Found::Nothing = found { self.take_old(old, &name) } else { Found::Nothing };
        let default = match old {
            Found::Nothing => default,
            Found::Value(value, line) => match whole_number(&value) {
                Some(number) => (number as f64 / whole as f64).min(1.0),
                None => self.refuse(key, line, &shown(&value), "a whole number of the run's actions", default),
            },
        };
        self.number_in(key, found, default, "", within(0.0, 1.0), doc)
    }

    fn number_in(&mut self, key: &str, found: Found<'t>, default: f64, unit: &str, range: Range, doc: &str) -> f64 {
        let value = match found {
            Found::Nothing => default,
            Found::Value(value, line) => match as_number(&value) {
                Some(number) if range.holds(number) => number,
                Some(number) => self.refuse(key, line, &number.to_string(), &format!("in {range}"), default),
                None => self.refuse(key, line, &shown(&value), &format!("a number in {range}"), default),
            },
        };
        self.write(key, &format!("{value:?}"), &format!("{}{range}: {doc}", spaced(unit)));
        value
    }

    /// What a key holds, as `read` takes it; refused where that gives nothing.
    fn value<T>(&mut self, key: &str, default: T, allowed: &str, read: impl FnOnce(&DeValue<'t>) -> Option<T>) -> T {
        match self.take(key) {
            Found::Nothing => default,
            Found::Value(value, line) => match read(&value) {
                Some(read) => read,
                None => self.refuse(key, line, &shown(&value), allowed, default),
            },
        }
    }

    /// A whole number.
    pub fn count(&mut self, key: &str, default: usize, unit: &str, range: RangeInclusive<usize>, doc: &str) -> usize {
        let allowed = format!("[{}, {}]", range.start(), range.end());
        let read = |value: &DeValue<'_>| whole_number(value).filter(|number| range.contains(number));
        let value = self.value(key, default, &format!("a whole number in {allowed}"), read);
        self.write(key, &value.to_string(), &format!("{}{allowed}: {doc}", spaced(unit)));
        value
    }

    /// `true` or `false`.
    pub fn flag(&mut self, key: &str, default: bool, doc: &str) -> bool {
        let value = self.value(key, default, "true or false", DeValue::as_bool);
        self.write(key, &value.to_string(), doc);
        value
    }

    /// A text.
    pub fn text(&mut self, key: &str, default: &str, doc: &str) -> String {
        let read = |value: &DeValue<'_>| value.as_str().map(str::to_owned);
        let value = self.value(key, default.to_owned(), "a text in quotes", read);
        self.write(key, &toml::Value::String(value.clone()).to_string(), doc);
        value
    }

    /// An existing file, relative to `base`; empty: none. The complete file names it by its absolute path.
    pub fn file(&mut self, key: &str, base: &Path, doc: &str) -> Option<PathBuf> {
        let value = match self.take(key) {
            Found::Nothing => None,
            Found::Value(DeValue::String(text), _) if text.is_empty() => None,
            Found::Value(DeValue::String(text), line) => {
                let path = base.join(text.as_ref());
                match path.canonicalize() {
                    Ok(found) => Some(found),
                    Err(cause) => {
                        self.fault(key, line, format!("= {text:?} cannot be read ({}): {cause}", path.display()));
                        None
                    }
                }
            }
            Found::Value(other, line) => self.refuse(key, line, &shown(&other), "a file name in quotes", None),
        };
        let shown = value.as_ref().map_or(String::new(), |path| path.to_string_lossy().into_owned());
        self.write(key, &toml::Value::String(shown).to_string(), doc);
        value
    }

    /// One of a few words, the first of them by default.
    pub fn choice<T: Copy>(&mut self, key: &str, choices: &[(&str, T)], doc: &str) -> T {
        self.choice_from(key, 0, choices, doc)
    }

    /// One of a few words; the default by its index.
    pub fn choice_from<T: Copy>(&mut self, key: &str, default: usize, choices: &[(&str, T)], doc: &str) -> T {
        let names = choices.iter().map(|(name, _)| format!("{name:?}")).collect::<Vec<_>>().join(" | ");
        let index = self.value(key, default, &names, |value| {
            value.as_str().and_then(|word| choices.iter().position(|(name, _)| *name == word))
        });
        self.write(key, &format!("{:?}", choices[index].0), &format!("{names}: {doc}"));
        choices[index].1
    }

    /// A number, or the word `"auto"` (`None`), which is the default.
    pub fn number_or_auto(&mut self, key: &str, unit: &str, range: Range, doc: &str) -> Option<f64> {
        self.number_or(key, None, "auto", unit, range, doc)
    }

    /// A number, or a word instead of it: `None`.
    pub fn number_or(
        &mut self,
        key: &str,
        default: Option<f64>,
        word: &str,
        unit: &str,
        range: Range,
        doc: &str,
    ) -> Option<f64> {
        let allowed = format!("\"{word}\" or a number in {range}");
        let read = |value: &DeValue<'_>| or_word(value, word, |value| as_number(value).filter(|&n| range.holds(n)));
        let value = self.value(key, default, &allowed, read);
        let shown = value.map_or_else(|| format!("{word:?}"), |number| format!("{number:?}"));
        self.write(key, &shown, &format!("{}{allowed}: {doc}", spaced(unit)));
        value
    }

    /// A point of the plane, `[x, y]` in metres.
    pub fn point(&mut self, key: &str, default: [f64; 2], doc: &str) -> [f64; 2] {
        let value = self.value(key, default, "two finite numbers, [x, y]", as_point);
        self.write(key, &format!("{value:?}"), &format!("m: {doc}"));
        value
    }

    /// The same, or a word instead of it: `None`.
    pub fn point_or(&mut self, key: &str, default: Option<[f64; 2]>, word: &str, doc: &str) -> Option<[f64; 2]> {
        let allowed = format!("two finite numbers, [x, y], or \"{word}\"");
        let value = self.value(key, default, &allowed, |value| or_word(value, word, as_point));
        let text = value.map_or_else(|| format!("{word:?}"), |point| format!("{point:?}"));
        self.write(key, &text, &format!("m, or \"{word}\": {doc}"));
        value
    }

    /// Whether a key stands in the file, or in `--set`.
    pub fn has(&self, key: &str) -> bool {
        let name = self.name(key);
        self.reader.overrides.contains_key(&name) || find(self.reader.root.get_ref(), &name).is_some()
    }

    /// At least two points, `[[x, y], …]` in metres; there is no default.
    pub fn points(&mut self, key: &str, doc: &str) -> Vec<[f64; 2]> {
        let allowed = "at least two points, [[x, y], [x, y], …]";
        let value = match self.take(key) {
            Found::Nothing => {
                self.fault(key, None, format!("is missing: it must be {allowed}"));
                Vec::new()
            }
            Found::Value(value, line) => {
                let points: Option<Vec<[f64; 2]>> =
                    value.as_array().and_then(|list| list.iter().map(|item| as_point(item.get_ref())).collect());
                match points {
                    Some(points) if points.len() >= 2 => points,
                    _ => self.refuse(key, line, &shown(&value), allowed, Vec::new()),
                }
            }
        };
        self.write(key, &format!("{value:?}"), &format!("m: {doc}"));
        value
    }

    /// A sub-section, `[this.name]`.
    pub fn inner<R>(&mut self, name: &str, doc: &str, read: impl FnOnce(&mut Section<'_, 't>) -> R) -> R {
        self.allow_sections(&[name]);
        let path = self.name(name);
        // Within a list, TOML means the last section of it, without its number.
        let words: Vec<&str> = path.split('.').filter(|word| word.parse::<usize>().is_err()).collect();
        self.reader.at(&path, &format!("[{}]", words.join(".")), doc, read)
    }

    /// The full name of a key of this section, as it stands in messages and `--set`.
    pub fn name(&self, key: &str) -> String {
        if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) }
    }

    /// Report that a key's value is not allowed for a reason of its own.
    pub fn fault_here(&mut self, key: &str, text: String) {
        let name = self.name(key);
        self.reader.fault_at(&name, text);
    }

    fn take(&mut self, key: &str) -> Found<'t> {
        let name = self.name(key);
        let found = self.take_as(key, &name);
        let old = RENAMED.iter().find(|(today, _)| *today == name).map(|(_, old)| *old);
        match (found, old) {
            (Found::Nothing, Some(old)) => self.take_old(old, &name),
            (found, _) => found,
        }
    }

    /// What a key holds that stands there with its old name; its name of today is `name`.
    fn take_old(&mut self, old: &str, name: &str) -> Found<'t> {
        let found = self.take_as(old, name);
        // In messages and hints it has the name of today.
        self.known.retain(|known| known != old || matches!(found, Found::Value(..)));
        if let Found::Value(_, line) = &found {
            let line = line.map_or(String::new(), |line| format!(" (line {line})"));
            self.reader.notes.push(format!("{}{line} is now called {name}", self.name(old)));
        }
        found
    }

    /// What a key holds that stands there as `key`; its place is kept as that of `name`.
    fn take_as(&mut self, key: &str, name: &str) -> Found<'t> {
        self.known.push(key.to_owned());
        let (stands, name) = (self.name(key), name.to_owned());
        if let Some(set) = self.reader.overrides.get_mut(&stands) {
            set.used = true;
            self.reader.lines.insert(name, None);
            return Found::Value(set.value.clone(), None);
        }
        match find(self.reader.root.get_ref(), &stands) {
            None => Found::Nothing,
            Some(value) => {
                let line = Some(line_of(self.reader.text, value.span().start));
                let found = value.get_ref().clone();
                self.reader.lines.insert(name, line);
                Found::Value(found, line)
            }
        }
    }

    fn refuse<T>(&mut self, key: &str, line: Option<usize>, value: &str, allowed: &str, default: T) -> T {
        self.fault(key, line, format!("= {value} is not allowed: it must be {allowed}"));
        default
    }

    fn fault(&mut self, key: &str, line: Option<usize>, text: String) {
        let key = self.name(key);
        self.reader.faults.push(Fault { line, key, text });
    }

    fn write(&mut self, key: &str, value: &str, comment: &str) {
        let _ = writeln!(self.reader.written, "{:<40} # {comment}", format!("{key} = {value}"));
    }

    /// Report keys that stand in the file but were not asked for; sub-sections are sections of their own.
    fn report_unknown(&mut self) {
        let table = if self.path.is_empty() {
            Some(self.reader.root.get_ref())
        } else {
            find(self.reader.root.get_ref(), &self.path).and_then(|value| value.get_ref().as_table())
        };
        let Some(table) = table else {
            if let Some(value) = find(self.reader.root.get_ref(), &self.path) {
                let line = Some(line_of(self.reader.text, value.span().start));
                let text = format!("is of type {}: it must be a section", value.get_ref().type_str());
                self.reader.faults.push(Fault { line, key: self.path.clone(), text });
            }
            return;
        };
        let mut faults = Vec::new();
        for (key, _) in table.iter() {
            let name: &str = key.get_ref();
            if self.known.iter().any(|known| known == name) {
                continue;
            }
            let nearest = self.known.iter().min_by_key(|known| strsim::levenshtein(known, name));
            let hint = match nearest {
                Some(known) if strsim::levenshtein(known, name) <= 3 => format!(": did you mean {known}?"),
                _ if self.known.is_empty() => String::new(),
                _ => format!(": known here are {}", self.known.join(", ")),
            };
            faults.push(Fault {
                line: Some(line_of(self.reader.text, key.span().start)),
                key: self.name(name),
                text: format!("is not a key of this section{hint}"),
            });
        }
        self.reader.faults.extend(faults);
    }

    /// Names of sub-sections and lists that are read on their own.
    pub fn allow_sections(&mut self, names: &[&str]) {
        self.known.extend(names.iter().map(|&name| name.to_owned()));
    }
}

/// Line of a byte offset, from 1.
fn line_of(text: &str, offset: usize) -> usize {
    text.as_bytes().iter().take(offset).filter(|&&byte| byte == b'\n').count() + 1
}

/// The value at a dotted path; numbers in the path index lists.
fn find<'a, 't>(table: &'a DeTable<'t>, path: &str) -> Option<&'a Spanned<DeValue<'t>>> {
    let mut parts = path.split('.');
    let mut value = table.get(parts.next()?)?;
    for part in parts {
        value = match value.get_ref() {
            DeValue::Table(table) => table.get(part)?,
            DeValue::Array(list) => list.get(part.parse::<usize>().ok()?)?,
            _ => return None,
        };
    }
    Some(value)
}

fn render(value: &DeValue<'_>) -> String {
    match value {
        DeValue::String(text) => toml::Value::String(text.to_string()).to_string(),
        DeValue::Integer(i) => match i.radix() {
            2 => format!("0b{}", i.as_str()),
            8 => format!("0o{}", i.as_str()),
            16 => format!("0x{}", i.as_str()),
            _ => i.as_str().to_owned(),
        },
        DeValue::Float(f) => f.as_str().to_owned(),
        DeValue::Boolean(flag) => flag.to_string(),
        DeValue::Datetime(time) => time.to_string(),
        DeValue::Array(list) => {
            format!("[{}]", list.iter().map(|item| render(item.get_ref())).collect::<Vec<_>>().join(", "))
        }
        DeValue::Table(_) => "{…}".to_owned(),
    }
}

fn shown(value: &DeValue<'_>) -> String {
    let text = render(value);
    if text.chars().count() > 60 { text.chars().take(57).chain("...".chars()).collect() } else { text }
}

fn whole_number(value: &DeValue<'_>) -> Option<usize> {
    let number = value.as_integer().and_then(|i| i128::from_str_radix(i.as_str(), i.radix()).ok());
    number.and_then(|n| usize::try_from(n).ok())
}

fn as_number(value: &DeValue<'_>) -> Option<f64> {
    match value {
        DeValue::Float(f) => f.as_str().replace('_', "").parse().ok(),
        DeValue::Integer(i) => i128::from_str_radix(i.as_str(), i.radix()).ok().map(|n| n as f64),
        _ => None,
    }
}

/// What `read` gives, or the word instead of it: the inner `None`.
fn or_word<T>(value: &DeValue<'_>, word: &str, read: impl Fn(&DeValue<'_>) -> Option<T>) -> Option<Option<T>> {
    if value.as_str() == Some(word) { Some(None) } else { read(value).map(Some) }
}

fn as_point(value: &DeValue<'_>) -> Option<[f64; 2]> {
    let list = value.as_array()?;
    let numbers: Vec<f64> =
        list.iter().filter_map(|item| as_number(item.get_ref())).filter(|n| n.is_finite()).collect();
    if list.len() == 2 && numbers.len() == 2 { Some([numbers[0], numbers[1]]) } else { None }
}

fn spaced(unit: &str) -> String {
    if unit.is_empty() { String::new() } else { format!("{unit}, ") }
}
