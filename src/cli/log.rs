//! What the program does, stage by stage, on standard error: with `-v`, or as SNAKELOOP_LOG asks for it. Otherwise nothing is collected.

use super::failure::Failure;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::fmt::format::FmtSpan;
use tracing_subscriber::fmt::time::uptime;
use tracing_subscriber::prelude::*;

/// The environment variable that asks for messages where no `-v` is given.
const VARIABLE: &str = "SNAKELOOP_LOG";
/// The target of the program's own messages.
const OWN: &str = "snakeloop";

/// Collects messages from here on: stages for one `-v`, single frames and fits for two.
///
/// # Errors
/// A SNAKELOOP_LOG that is neither a level nor a list of targets with levels.
pub fn start(verbosity: u8) -> Result<(), Failure> {
    let Some(filter) = filter(verbosity, std::env::var(VARIABLE).ok().as_deref())? else { return Ok(()) };
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(std::io::stderr)
        .with_ansi(false)
        .with_timer(uptime())
        .with_span_events(FmtSpan::CLOSE)
        // Where nobody takes a line, it is lost and the work goes on.
        .log_internal_errors(false);
    tracing_subscriber::registry().with(lines.with_filter(filter)).init();
    Ok(())
}

/// Which messages are wanted; `None` if none are.
fn filter(verbosity: u8, variable: Option<&str>) -> Result<Option<Targets>, Failure> {
    let own = |level| Targets::new().with_target(OWN, level);
    match (verbosity, variable.map(str::trim)) {
        (0, None | Some("")) => Ok(None),
        (0, Some(text)) => match text.parse::<LevelFilter>() {
            Ok(LevelFilter::OFF) => Ok(None),
            Ok(level) => Ok(Some(own(level))),
            Err(_) => text.parse().map(Some).map_err(|_| unknown(text)),
        },
        (1, _) => Ok(Some(own(LevelFilter::INFO))),
        (_, _) => Ok(Some(own(LevelFilter::DEBUG))),
    }
}

fn unknown(text: &str) -> Failure {
    Failure::Usage(format!(
        "{VARIABLE}={text}: expected off, info or debug, or targets with levels such as snakeloop::discover=debug,snakeloop::cli=info"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use tracing::Level;

    #[test]
    fn nothing_is_collected_unless_it_is_asked_for() {
        for variable in [None, Some(""), Some("off")] {
            assert!(filter(0, variable).unwrap().is_none(), "{variable:?}");
        }
    }

    #[test]
    fn a_flag_counts_more_than_the_variable_and_only_own_messages_are_shown_for_a_level() {
        let wanted = |verbosity, variable, target, level| {
            filter(verbosity, variable).unwrap().is_some_and(|filter| filter.would_enable(target, &level))
        };
        assert!(wanted(1, None, "snakeloop::cli", Level::INFO) && !wanted(1, None, "snakeloop::cli", Level::DEBUG));
        assert!(wanted(2, Some("info"), "snakeloop::cli", Level::DEBUG));
        assert!(wanted(0, Some("debug"), "snakeloop::live", Level::DEBUG));
        assert!(!wanted(0, Some("debug"), "rustdds", Level::ERROR));
        let named = Some("snakeloop::discover=debug");
        assert!(
            wanted(0, named, "snakeloop::discover", Level::DEBUG) && !wanted(0, named, "snakeloop::cli", Level::INFO)
        );
    }

    #[test]
    fn a_variable_that_asks_for_nothing_known_is_wrong_usage() {
        let error = filter(0, Some("snakeloop=loud")).unwrap_err();
        assert!(error.to_string().contains("SNAKELOOP_LOG=snakeloop=loud"), "{error}");
        assert_eq!(error.exit_code(), 2);
    }
}
