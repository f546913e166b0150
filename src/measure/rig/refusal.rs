//! Why a rig was not calibrated.

/// Where a try to calibrate a rig ended, the first step first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Step {
    /// Finding what may be the holder.
    Holder,
    /// Finding the grid.
    Grid,
    /// Finding the holder's upper end.
    Start,
    /// Fitting the snake.
    Snake,
    /// All was found, but not where scale and standoff say.
    Scale,
}

/// Why a try ended. Of several tries the one that came furthest tells most.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Refusal {
    pub step: Step,
    /// A sentence that says what failed and what to do.
    pub message: String,
}

impl Refusal {
    pub fn at(step: Step) -> impl Fn(String) -> Self {
        move |message| Self { step, message }
    }

    /// The one that tells more; the first of two that came as far.
    pub fn telling(self, former: Option<Self>) -> Self {
        match former {
            Some(former) if former.step >= self.step => former,
            _ => self,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_of_those_that_came_furthest_is_told() {
        let tries = [(Step::Grid, "a"), (Step::Snake, "b"), (Step::Start, "c"), (Step::Snake, "d")];
        let refusals = tries.map(|(step, message)| Refusal::at(step)(message.to_owned()));
        let told = refusals.into_iter().fold(None, |former, refusal| Some(refusal.telling(former)));
        assert_eq!(told, Some(Refusal { step: Step::Snake, message: "b".into() }));
    }
}
