//! The verdict as a box on top of a page, in its colour and in words.

use super::page::{document, made_from};
use crate::record::Provenance;
use crate::verdict::{Level, Reason, Verdict};
use maud::{Markup, html};

/// A page that tells why there is nothing else to show.
pub fn verdict_page(title: &str, verdict: &Verdict, from: &Provenance) -> String {
    document(title, "", &html! { h1 { (title) } (verdict_box(verdict)) (made_from(from)) })
}

/// A page that tells a verdict and nothing else.
pub fn verdict_alone(verdict: &Verdict) -> String {
    document("snakeloop: verdict", "", &verdict_box(verdict))
}

/// The box.
pub(super) fn verdict_box(verdict: &Verdict) -> Markup {
    let (class, says) = match verdict.level {
        Level::Good => ("verdict good", "Good: nothing speaks against this result."),
        Level::Look => ("verdict look", "Look at this before you use the result."),
        Level::DoNotUse => ("verdict do-not-use", "Do not use this result."),
    };
    html! {
        section class=(class) {
            p.says { (says) }
            @if !verdict.reasons.is_empty() {
                ol {
                    @for Reason { text, remedy, .. } in &verdict.reasons {
                        li { (with_code(&sentence(text))) p.remedy { b { "What to do: " } (with_code(remedy)) "." } }
                    }
                }
            }
        }
    }
}

/// Text in which what stands between backticks is code.
pub(super) fn with_code(text: &str) -> Markup {
    html! {
        @for (place, part) in text.split('`').enumerate() {
            @if place % 2 == 1 { code { (part) } } @else { (part) }
        }
    }
}

/// Text as a sentence: its first letter is large where it begins a word, and not a symbol such as q3 or η.
fn sentence(text: &str) -> String {
    let word: String = text.chars().take_while(|letter| letter.is_ascii_lowercase()).collect();
    if word.len() < 2 {
        return format!("{text}.");
    }
    format!("{}{}.", text[..1].to_ascii_uppercase(), &text[1..])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verdict::Code;

    #[test]
    fn the_box_has_the_level_as_its_class_and_every_reason_with_its_remedy() {
        assert!(verdict_box(&Verdict::default()).into_string().contains("class=\"verdict good\""));
        let reason = Reason::new(Code::Wiring, Level::DoNotUse, "encoder <log>: swapped", "`a b`, write [wiring]");
        let text = verdict_box(&Verdict::of(vec![reason])).into_string();
        for part in
            ["class=\"verdict do-not-use\"", "Encoder &lt;log&gt;: swapped.", "<code>a b</code>, write [wiring]."]
        {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert_eq!((sentence("η = 4"), sentence("q3 stands still")), ("η = 4.".into(), "q3 stands still.".into()));
    }
}
