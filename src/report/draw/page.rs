//! A page: one HTML file that loads nothing, made of sections, tables and drawings.

use std::fmt::Write as _;

/// A text with what HTML would read as its own replaced.
pub fn escape(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            '\'' => safe.push_str("&#39;"),
            // Other control characters are not allowed in a page.
            c if c.is_control() && c != '\n' && c != '\t' => safe.push('\u{fffd}'),
            c => safe.push(c),
        }
    }
    safe
}

/// A table: its columns, and its rows of texts.
#[derive(Debug, Clone, Default)]
pub struct Table {
    /// Heads of the columns.
    pub head: Vec<String>,
    /// Rows, each as long as the head.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// A table without rows.
    pub fn new(head: &[&str]) -> Self {
        Table { head: head.iter().map(|&head| head.to_owned()).collect(), rows: Vec::new() }
    }

    /// One more row.
    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.rows.push(cells.into_iter().collect());
    }

    fn html(&self) -> String {
        let mut html = String::from("<div class=\"wide\"><table><thead><tr>");
        for head in &self.head {
            let _ = write!(html, "<th>{}</th>", escape(head));
        }
        html.push_str("</tr></thead><tbody>\n");
        for row in &self.rows {
            html.push_str("<tr>");
            for cell in row {
                let _ = write!(html, "<td>{}</td>", escape(cell));
            }
            html.push_str("</tr>\n");
        }
        html + "</tbody></table></div>\n"
    }
}

/// A page that is being made. All texts are escaped; only drawings are taken as they are.
#[derive(Debug, Clone)]
pub struct Page {
    title: String,
    body: String,
    /// Whether a row of drawings is open.
    figures: bool,
}

const STYLE: &str = "
:root{color-scheme:light dark;--ink:#282c34;--paper:#fff;--soft:#5c6370;--line:#d7dae0;--box:#f4f6f8;--good:#1e7b45;--fair:#9a6700;--bad:#b3202a}
@media(prefers-color-scheme:dark){:root{--ink:#e6e8eb;--paper:#16181d;--soft:#a4abb6;--line:#3a3f4a;--box:#20242b;--good:#5fce8d;--fair:#e2b348;--bad:#ff7b81}}
*{box-sizing:border-box}
body{margin:0 auto;max-width:1240px;padding:16px;background:var(--paper);color:var(--ink);font:16px/1.5 system-ui,sans-serif;overflow-wrap:break-word}
h1{font-size:1.5rem;line-height:1.25;margin:.2em 0 .5em}
h2{font-size:1.2rem;margin:2em 0 .4em;border-bottom:1px solid var(--line)}
p{margin:.5em 0;max-width:75ch}
.verdict{max-width:80ch;background:var(--box);border-left:5px solid var(--soft);padding:.6em 1em;margin:.8em 0}
.verdict.good{border-color:var(--good)}.verdict.fair{border-color:var(--fair)}.verdict.bad{border-color:var(--bad)}
.verdict strong{font-size:1.15rem}
.note{color:var(--soft)}
.figures{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,480px),1fr));gap:16px;margin:.8em 0}
figure{margin:0;min-width:0}
figure svg{display:block;width:100%;height:auto;background:#fff;border:1px solid var(--line);border-radius:4px}
figcaption{color:var(--soft);font-size:.9rem;margin-top:.3em}
.wide{overflow-x:auto;margin:.6em 0}
table{border-collapse:collapse;font-variant-numeric:tabular-nums}
th,td{padding:.2em .7em;border-bottom:1px solid var(--line);text-align:right;white-space:nowrap}
th{color:var(--soft);font-weight:600}
th:first-child,td:first-child{text-align:left;white-space:normal}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.2em 1.2em;margin:.6em 0}
dt{color:var(--soft)}dd{margin:0;overflow-wrap:anywhere}
details{margin:.6em 0}
summary{cursor:pointer}
nav{font-size:.95rem}nav a{margin-right:1em;display:inline-block}
a{color:inherit}
";

impl Page {
    /// A page with a title.
    pub fn new(title: &str) -> Self {
        Page { title: title.to_owned(), body: format!("<h1>{}</h1>\n", escape(title)), figures: false }
    }

    fn add(&mut self, html: &str) {
        if self.figures {
            self.body.push_str("</div>\n");
            self.figures = false;
        }
        self.body.push_str(html);
    }

    /// A heading, with a name that addresses can point to.
    pub fn section(&mut self, name: &str, heading: &str) {
        self.add(&format!("<h2 id=\"{}\">{}</h2>\n", escape(name), escape(heading)));
    }

    /// Links to sections: their names and headings.
    pub fn contents(&mut self, sections: &[(&str, &str)]) {
        let mut html = String::from("<nav>");
        for (name, heading) in sections {
            let _ = write!(html, "<a href=\"#{}\">{}</a> ", escape(name), escape(heading));
        }
        self.add(&(html + "</nav>\n"));
    }

    /// A paragraph.
    pub fn text(&mut self, text: &str) {
        self.add(&format!("<p>{}</p>\n", escape(text)));
    }

    /// A paragraph of less weight: what is missing and why, how to read something.
    pub fn note(&mut self, text: &str) {
        self.add(&format!("<p class=\"note\">{}</p>\n", escape(text)));
    }

    /// A judgement: one of `good`, `fair`, `bad` or nothing, its headline, and its sentences.
    pub fn verdict(&mut self, class: &str, headline: &str, sentences: &[String]) {
        let mut html =
            format!("<div class=\"verdict {}\"><p><strong>{}</strong></p>\n", escape(class), escape(headline));
        for sentence in sentences {
            let _ = writeln!(html, "<p>{}</p>", escape(sentence));
        }
        self.add(&(html + "</div>\n"));
    }

    /// A table.
    pub fn table(&mut self, table: &Table) {
        self.add(&table.html());
    }

    /// Names and what they stand for.
    pub fn facts(&mut self, facts: &[(String, String)]) {
        let mut html = String::from("<dl>\n");
        for (name, value) in facts {
            let _ = writeln!(html, "<dt>{}</dt><dd>{}</dd>", escape(name), escape(value));
        }
        self.add(&(html + "</dl>\n"));
    }

    /// A table that is opened on demand.
    pub fn folded_table(&mut self, summary: &str, table: &Table) {
        self.add(&format!("<details><summary>{}</summary>{}</details>\n", escape(summary), table.html()));
    }

    /// A drawing with its name, its title (for those who cannot see it) and a caption.
    pub fn figure(&mut self, name: &str, title: &str, caption: &str, svg: &str) {
        if !self.figures {
            self.body.push_str("<div class=\"figures\">\n");
            self.figures = true;
        }
        let head = format!("<svg role=\"img\" aria-label=\"{}\" ", escape(title));
        let svg = svg.trim_start().replacen("<svg ", &head, 1);
        let _ = write!(self.body, "<figure id=\"{}\">{svg}", escape(name));
        if !caption.is_empty() {
            let _ = write!(self.body, "<figcaption>{}</figcaption>", escape(caption));
        }
        self.body.push_str("</figure>\n");
    }

    /// The whole file.
    pub fn html(mut self) -> String {
        self.add("");
        let generator = concat!("adagio ", env!("CARGO_PKG_VERSION"));
        format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <meta name=\"generator\" content=\"{generator}\">\n\
             <link rel=\"icon\" href=\"data:,\">\n\
             <title>{}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n{}</body>\n</html>\n",
            escape(&self.title),
            self.body
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_of_others_stay_texts() {
        let mut page = Page::new("<script>alert('x')</script>");
        page.verdict("\"><b>", "a & b", &["</div>".to_owned()]);
        let mut table = Table::new(&["<i>"]);
        table.row(["\u{7}<td>".to_owned()]);
        page.table(&table);
        let html = page.html();
        assert!(!html.contains("<script") && !html.contains("<b>") && !html.contains("<i>"));
        assert!(html.contains("&lt;script&gt;alert(&#39;x&#39;)&lt;/script&gt;"));
        assert!(html.contains("<td>\u{fffd}&lt;td&gt;</td>"));
        assert_eq!(html.matches("</div>").count(), 2);
    }
}
