//! HTML as text, for the page that has no template yet.

pub(super) fn definitions(class: &str, pairs: &[(String, String)]) -> String {
    let rows: String =
        pairs.iter().map(|(k, v)| format!("<div><dt>{}</dt><dd>{}</dd></div>\n", escaped(k), escaped(v))).collect();
    format!("<dl class=\"{class}\">\n{rows}</dl>\n")
}

pub(super) fn table<const N: usize>(title: &str, header: [&str; N], rows: &[[String; N]]) -> String {
    let cells = |tag: &str, texts: &[String]| {
        texts.iter().map(|text| format!("<{tag}>{}</{tag}>", escaped(text))).collect::<String>()
    };
    let body: String = rows.iter().map(|row| format!("<tr>{}</tr>\n", cells("td", row))).collect();
    let head = cells("th", &header.map(str::to_owned));
    format!(
        "<h2>{} ({})</h2>\n<div class=\"wide\"><table>\n<tr>{head}</tr>\n{body}</table></div>\n",
        escaped(title),
        rows.len()
    )
}

pub(super) fn list(title: &str, note: &str, items: &[String]) -> String {
    if items.is_empty() {
        return String::new();
    }
    let items: String = items.iter().map(|item| format!("<li>{}</li>\n", escaped(item))).collect();
    format!("<h2>{title}</h2>\n<p>{note}</p>\n<ul>\n{items}</ul>\n")
}

/// Text as it must stand in HTML.
pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

pub(super) fn style() -> String {
    include_str!("report.css").to_owned()
}
