//! What may import what, as ARCHITECTURE.md says: held against every `use` and every path in `src/`.
//!
//! Not looked at: what is compiled for tests only, and what a module imports from its own submodules.

use std::collections::{BTreeMap, BTreeSet};

use crate::common::package_file;

/// The rooms: none imports one that stands after it.
const ROOMS: &str = "random snapshot lock kernel dictionary regression slow value log gpu robot scenario vision policy source ros2 world \
    evaluate agent replay learn export report live fleet experiment soak cli";
/// Rooms that import only each other, and these rooms and crates.
const PURE: &str = "kernel dictionary regression slow value";
const BELOW_PURE: &str = "random snapshot";
const CRATES_OF_PURE: &str = "faer pulp rand rand_chacha rand_distr libm thiserror serde serde_json rayon";
/// What nothing in a folder imports.
const APART: [(&str, &str); 9] = [
    ("agent::runtime", "agent::actors"),
    ("agent::runtime", "agent::run"),
    // `agent/interleavings.rs` is compiled for tests only.
    ("agent::actors", "world"),
    ("agent::runtime", "world"),
    ("agent::run", "world"),
    ("replay", "world"),
    ("learn", "world"),
    ("fleet", "world"),
    ("export", "world"),
];

/// Words, `::` and other signs with their lines; no comments and no literals.
fn tokens(source: &str) -> Vec<(usize, &str)> {
    let (mut found, mut at, mut line) = (Vec::new(), 0, 1);
    while let Some(first) = source[at..].chars().next() {
        let rest = &source[at..];
        let past = |from: usize, end: &str| rest[from..].find(end).map_or(rest.len(), |at| from + at + end.len());
        let word = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
        let is_escaped = |at: usize| rest[1..at].bytes().rev().take_while(|byte| *byte == b'\\').count() % 2 == 1;
        let (length, keep) = match rest.as_bytes() {
            [b'/', b'/', ..] => (past(2, "\n"), false),
            [b'/', b'*', ..] => (past(2, "*/"), false),
            [b'\'', b'\\', ..] => (past(3, "'"), false),
            // A character, or a lifetime.
            [b'\'', ..] => (rest.char_indices().nth(2).filter(|end| end.1 == '\'').map_or(1, |end| end.0 + 1), false),
            [b'r', b'"', ..] => (past(2, "\""), false),
            [b'r', b'#', b'"', ..] => (past(3, "\"#"), false),
            [b'"', ..] => {
                (rest.match_indices('"').skip(1).find(|end| !is_escaped(end.0)).map_or(1, |end| end.0 + 1), false)
            }
            [b':', b':', ..] => (2, true),
            _ if word > 0 => (word, true),
            _ => (first.len_utf8(), !first.is_whitespace()),
        };
        found.extend(keep.then(|| (line, &rest[..length])));
        line += rest[..length].matches('\n').count();
        at += length;
    }
    found
}

/// A path, and the name that a `use` gives it.
struct Import<'a> {
    line: usize,
    path: Vec<&'a str>,
    name: Option<&'a str>,
}

/// The imports of a `use`, from behind that word on.
fn tree<'a>(tokens: &[(usize, &'a str)], i: &mut usize, prefix: &[&'a str], found: &mut Vec<Import<'a>>) {
    let (line, mut path, mut name) = (tokens[*i].0, prefix.to_vec(), None);
    while !matches!(tokens[*i].1, "," | "}" | ";") {
        match tokens[*i].1 {
            "{" => {
                while tokens[*i].1 != "}" {
                    *i += 1;
                    tree(tokens, i, &path, found);
                }
                *i += 1;
                return;
            }
            "as" => name = Some(tokens[*i + 1].1),
            segment if segment != "::" && name.is_none() => path.push(segment),
            _ => {}
        }
        *i += 1;
    }
    path.pop_if(|last| *last == "self");
    found.push(Import { line, name: name.or(path.last().copied()), path });
}

/// What a file imports, and the items in it.
type File<'a> = (Vec<Import<'a>>, BTreeSet<&'a str>);

fn read<'a>(source: &'a str) -> File<'a> {
    let (tokens, mut imports, mut items, mut i) = (tokens(source), Vec::new(), BTreeSet::new(), 0);
    let text = |i: usize| tokens.get(i).map_or("", |token| token.1);
    while i < tokens.len() {
        match text(i) {
            "#" if text(i + 2) == "cfg" => {
                let words: Vec<&str> = (i..).map(text).take_while(|text| !matches!(*text, "]" | "")).collect();
                i += words.len();
                if words.contains(&"test") && !words.contains(&"not") {
                    let mut depth = 0;
                    while i < tokens.len() && !(depth <= 0 && matches!(text(i), ";" | "}")) {
                        i += 1;
                        depth += i32::from("([{".contains(text(i))) - i32::from(")]}".contains(text(i)));
                    }
                }
            }
            "use" if text(i + 1) != "<" => {
                i += 1;
                tree(&tokens, &mut i, &[], &mut imports);
            }
            "struct" | "enum" | "trait" | "type" | "fn" | "const" | "static" => items.extend([text(i + 1)]),
            // But not the path in `pub(in path)`.
            head if text(i + 1) == "::" && head != ">" && !(i > 1 && text(i - 2) == "(" && text(i - 1) == "in") => {
                let (line, mut path) = (tokens[i].0, vec![head]);
                while text(i + 1) == "::" {
                    path.push(text(i + 2));
                    i += 2;
                }
                imports.push(Import { line, path, name: None });
            }
            _ => {}
        }
        i += 1;
    }
    (imports, items)
}

/// The module that a path leads to, re-exports followed, and whether it names that module itself; `module` for other crates' paths.
fn resolve(files: &BTreeMap<String, File<'_>>, module: &str, path: &[&str], depth: usize) -> Option<(String, bool)> {
    let ups = path.iter().take_while(|segment| **segment == "super").count();
    let mut at = if path.first() == Some(&"crate") { String::new() } else { module.to_owned() };
    (0..ups).for_each(|_| at.truncate(at.rfind("::").unwrap_or(0)));
    for name in path.iter().skip_while(|segment| matches!(**segment, "crate" | "self" | "super")) {
        let below = format!("{at}::{name}").trim_start_matches(':').to_owned();
        if files.contains_key(&below) {
            at = below;
            continue;
        }
        let (imports, items) = files.get(&at).filter(|_| depth > 0)?;
        let through = |import: &Import<'_>| match import.name? {
            "*" => {
                let path = [&import.path[..import.path.len() - 1], &[*name]].concat();
                let found = resolve(files, &at, &path, depth - 1)?;
                (found.1 || files[&found.0].1.contains(name)).then_some(found)
            }
            bound => (bound == *name).then(|| resolve(files, &at, &import.path, depth - 1))?,
        };
        match imports.iter().find_map(through).filter(|_| !items.contains(name)) {
            Some((module, true)) => at = module,
            found => return found.or(Some((at, false))),
        }
    }
    Some((at, true))
}

/// What breaks the rules: in sources by their paths in `src/`, of a crate that depends on `crates`.
fn faults(sources: &[(&str, &str)], crates: &[&str]) -> Vec<String> {
    let module = |path: &str| path.trim_end_matches(".rs").trim_end_matches("/mod").replace('/', "::");
    let files = sources.iter().map(|(path, source)| (module(path), read(source))).collect::<BTreeMap<_, _>>();
    let within = |module: &str, outer: &str| format!("{module}::").starts_with(&format!("{outer}::"));
    let (mut faults, mut edges) = (BTreeSet::new(), BTreeMap::new());
    let has = |list: &str, name: &str| list.split_whitespace().any(|entry| entry == name);
    let rank = |room: &str| ROOMS.split_whitespace().position(|entry| entry == room);
    for (path, _) in sources.iter().filter(|(path, _)| !matches!(*path, "lib.rs" | "main.rs")) {
        let module = &module(path);
        let from = module.split("::").next().unwrap_or_default();
        if rank(from).is_none() {
            faults.insert(format!("src/{path}: `{from}` is not among the ROOMS: add it where it belongs"));
        }
        for import in &files[module].0 {
            let imports = format!("src/{path}:{}: imports {}, but ", import.line, import.path.join("::"));
            let mut fault = |rule: String| faults.insert(format!("{imports}{rule}"));
            if has(PURE, from) && crates.contains(&import.path[0]) && !has(CRATES_OF_PURE, import.path[0]) {
                fault(format!("`{from}` may import these crates only: {CRATES_OF_PURE}"));
            }
            let found = resolve(&files, module, &import.path, 6);
            let Some((to, _)) = found.filter(|(to, _)| !to.is_empty() && !within(to, module)) else { continue };
            let room = to.split("::").next().unwrap_or_default();
            if rank(room) > rank(from) {
                fault(format!("`{room}` stands above `{from}`"));
            }
            if has(PURE, from) && !has(PURE, room) && !has(BELOW_PURE, room) {
                fault(format!("`{from}` is pure mathematics and may import only: {PURE} {BELOW_PURE}"));
            }
            for (folder, other) in APART.iter().filter(|rule| within(module, rule.0) && within(&to, rule.1)) {
                fault(format!("nothing in `{folder}` imports `{other}`"));
            }
            edges.entry((module.clone(), to)).or_insert(imports);
        }
    }
    for ((from, to), imports) in &edges {
        let (mut reached, mut next) = (BTreeSet::new(), vec![to]);
        while let Some(at) = next.pop() {
            next.extend(edges.keys().filter(|edge| edge.0 == *at && reached.insert(&edge.1)).map(|edge| &edge.1));
        }
        if reached.contains(from) {
            faults.insert(format!("{imports}`{to}` imports this file in turn, directly or through others"));
        }
    }
    faults.into_iter().collect()
}

#[test]
fn no_file_imports_upwards_or_in_a_circle() {
    let (src, mut paths, mut sources) = (package_file("src"), vec![package_file("src")], Vec::new());
    while let Some(path) = paths.pop() {
        if path.is_dir() {
            paths.extend(std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path()));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let name = path.strip_prefix(&src).unwrap().to_str().unwrap().replace('\\', "/");
            sources.push((name, std::fs::read_to_string(path).unwrap()));
        }
    }
    let sources: Vec<(&str, &str)> = sources.iter().map(|(path, source)| (path.as_str(), source.as_str())).collect();
    let manifest = std::fs::read_to_string(package_file("Cargo.toml")).unwrap().replace('-', "_");
    let listed = manifest.split("[dependencies]\n").nth(1).unwrap().split("\n[").next().unwrap();
    let crates: Vec<&str> = listed.lines().filter_map(|line| Some(line.split_once(" =")?.0)).collect();
    assert!(sources.len() > 100 && crates.len() > 20, "{} files, {crates:?}", sources.len());
    let faults = faults(&sources, &crates);
    assert!(faults.is_empty(), "see ARCHITECTURE.md:\n{}", faults.join("\n"));
}

#[test]
fn the_rules_find_what_breaks_them() {
    let check = |sources: &[(&str, &str)], expected: &[&str]| {
        let found = faults(sources, &["faer", "mcap"]);
        assert_eq!(found.len(), expected.len(), "{sources:?}: {found:?}");
        found.iter().zip(expected).for_each(|(found, part)| assert!(found.contains(part), "{found} has no {part}"));
    };
    let (cli, run) = (("cli/mod.rs", "pub use run::x; mod run;"), ("cli/run.rs", "pub fn x() {}"));
    for (source, fault) in [
        ("use crate::cli::x;", "src/log/a/mod.rs:1: imports crate::cli::x, but `cli` stands above `log`"),
        ("use crate::{\n    log::{y, z as x},\n    cli::{self as other},\n};", "mod.rs:3: imports crate::cli, but"),
        ("fn f<'a>(_: &'a u8) {\n crate::cli::x(); '\\''; }", "mod.rs:2: imports crate::cli::x, but"),
        ("#[cfg(not(test))]\npub(crate) use super::super::cli;", "mod.rs:2: imports super::super::cli, but"),
    ] {
        check(&[("log/a/mod.rs", source), cli, run], &[fault]);
    }
    for source in [
        "// use crate::cli::x;\n/* crate::cli::x() */ use faer::Mat;",
        "const A: &str = \"\\\\\\\" crate::cli::x()\"; const B: &str = r#\"\" crate::cli::x()\"#;",
        "#[cfg(test)]\nmod tests { use crate::cli::x; fn f() { { } } }\npub(in crate::log) fn g() {}",
        "#[cfg(all(test, unix))] #[allow(unused)] use crate::{cli::{x}};\nfn f() -> impl Sized + use<> {}",
    ] {
        check(&[("log/mod.rs", source), cli, run], &[]);
    }
    // Through re-exports and globs.
    let (a, b) = (("world/mod.rs", "pub use {b::B, c::*};"), ("world/b.rs", "use super::C;\npub struct B;"));
    check(&[a, b, ("world/c.rs", "pub struct C;")], &[]);
    let circle =
        ["b.rs:1: imports super::C, but `world::c` imports", "c.rs:2: imports super::B, but `world::b` imports"];
    check(&[a, b, ("world/c.rs", "pub struct C;\nfn f(_: super::B) {}")], &circle);
    let pure =
        ["mod.rs:1: imports mcap::Writer, but `slow` may", "`slow` is pure mathematics", "`world` stands above `slow`"];
    check(&[("slow/mod.rs", "use mcap::Writer;\nuse crate::world::B;"), a, b], &pure);
    let apart = "imports crate::agent::run, but nothing in `agent::runtime` imports `agent::run`";
    check(&[("agent/runtime/x.rs", "use crate::agent::run;"), ("agent/mod.rs", ""), ("agent/run.rs", "")], &[apart]);
    check(&[("elsewhere.rs", "")], &["src/elsewhere.rs: `elsewhere` is not among the ROOMS"]);
}
