//! What all report pages share. A page holds its style, plots and pictures itself and asks no other address for anything.

use super::plot::Plot;
use crate::record::Provenance;
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// The style of all pages.
const STYLE: &str = include_str!("report.css");
/// What answers a hover and opens pictures. Everything is there without it.
const SCRIPT: &str = include_str!("page.js");

/// A whole page: its title, style of its own besides what all pages share, and what stands on it.
pub(super) fn document(title: &str, own_style: &str, content: &Markup) -> String {
    let document = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (PreEscaped(STYLE)) (PreEscaped(own_style)) }
            }
            body {
                main { (content) }
                script { (PreEscaped(SCRIPT)) }
            }
        }
    };
    document.into_string()
}

/// Names with their values.
pub(super) fn definitions(class: &str, pairs: &[(String, String)]) -> Markup {
    html! {
        dl class=(class) {
            @for (name, value) in pairs { div { dt { (name) } dd { (value) } } }
        }
    }
}

/// What the page was made from, as its last section.
pub(super) fn made_from(made_from: &Provenance) -> Markup {
    html! { h2 { "Made from" } (definitions("provenance", &made_from.lines())) }
}

/// A section with a table, which a click on a column's name sorts; the heading tells the number of rows.
pub(super) fn table<const N: usize>(title: &str, header: [&str; N], rows: &[[String; N]]) -> Markup {
    html! {
        h2 { (title) " (" (rows.len()) ")" }
        .wide {
            table.sortable {
                tr { @for name in header { th { (name) } } }
                @for row in rows {
                    tr { @for cell in row { td { (cell) } } }
                }
            }
        }
    }
}

/// A section with a list, where there is something to list.
pub(super) fn list(title: &str, note: &str, items: &[String]) -> Markup {
    html! {
        @if !items.is_empty() {
            h2 { (title) }
            p { (note) }
            ul { @for item in items { li { (item) } } }
        }
    }
}

/// A plot with its title and caption; nothing where the plot has no points.
pub(super) fn figure(title: &str, plot: &Plot, caption: &str) -> Markup {
    html! {
        @if let Some(svg) = plot.svg() {
            figure {
                h3 { (title) }
                (inline_svg(&svg))
                @if !caption.is_empty() { figcaption { (caption) } }
            }
        }
    }
}

/// An SVG document as an element of a page, which needs no namespace.
fn inline_svg(svg: &str) -> Markup {
    PreEscaped(svg.replace(" xmlns=\"http://www.w3.org/2000/svg\"", ""))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::plot::{GRID, INK};

    #[test]
    fn the_style_gives_the_plots_the_pages_colours() {
        for colour in [INK, GRID] {
            assert!(STYLE.contains(&format!("\"{colour}\"")), "{colour}");
        }
    }

    #[test]
    fn text_is_escaped_wherever_it_stands() {
        let text = "<script>&\"".to_owned();
        let escaped = "&lt;script&gt;&amp;&quot;";
        let pairs = [(text.clone(), text.clone())];
        let cells = [[text.clone()]];
        for markup in [
            definitions(&text, &pairs),
            table(&text, [&text], &cells),
            list(&text, &text, std::slice::from_ref(&text)),
            html! { (PreEscaped(document(&text, "", &html! {}))) },
        ] {
            let written = markup.into_string().replace(&format!("<script>{SCRIPT}</script>"), "");
            assert!(written.contains(escaped) && !written.contains("<script>"), "{written}");
        }
    }

    #[test]
    fn an_empty_list_and_an_empty_plot_leave_no_trace() {
        assert_eq!(list("a", "b", &[]).into_string(), "");
        let plot = Plot { x_label: "x".into(), y_label: "y".into(), series: vec![], y_shown: vec![] };
        assert_eq!(figure("a", &plot, "b").into_string(), "");
    }
}
