//! The dashboard in a real browser: Debian's chromium, led by its chromedriver.

use super::fixture::experiment;
use super::streams::{camera, encoder_lines, never, start};
use fantoccini::wd::{Capabilities, WebDriverCompatibleCommand};
use fantoccini::{Client, ClientBuilder, Locator};
use serde_json::{Value, json};
use std::net::TcpListener;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// What the console has said so far, which is chromedriver's own command.
#[derive(Debug)]
struct ConsoleLog;

impl WebDriverCompatibleCommand for ConsoleLog {
    fn endpoint(&self, base: &url::Url, session: Option<&str>) -> Result<url::Url, url::ParseError> {
        base.join(&format!("session/{}/se/log", session.unwrap_or_default()))
    }

    fn method_and_body(&self, _: &url::Url) -> (http::Method, Option<String>) {
        (http::Method::POST, Some(json!({ "type": "browser" }).to_string()))
    }
}

struct Driver(Child);

impl Drop for Driver {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A chromedriver at a free port, and a browser.
async fn browser() -> (Driver, Client) {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let driver = Command::new("chromedriver").arg(format!("--port={port}")).stdout(Stdio::null()).spawn();
    let driver =
        Driver(driver.expect("chromedriver is needed; tools/test installs it (Debian: chromium chromium-driver)"));
    let options = json!({
        "goog:chromeOptions": { "args": ["--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--window-size=1400,1100"] },
        "goog:loggingPrefs": { "browser": "ALL" },
    });
    let Value::Object(capabilities) = options else { unreachable!() };
    let capabilities: Capabilities = capabilities;
    let deadline = Instant::now() + Duration::from_secs(30);
    loop {
        let mut builder = ClientBuilder::new(hyper_util::client::legacy::connect::HttpConnector::new());
        match builder.capabilities(capabilities.clone()).connect(&format!("http://127.0.0.1:{port}")).await {
            Ok(client) => return (driver, client),
            Err(e) => assert!(Instant::now() < deadline, "no browser: {e}"),
        }
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
}

/// How long the page may take to show anything: to find that a bent snake is no straight reference takes half a minute, and more on a
/// busy machine.
const PATIENCE: Duration = Duration::from_secs(180);

struct Page(Client);

impl Page {
    async fn text(&self, id: &str) -> String {
        self.0.find(Locator::Id(id)).await.unwrap().text().await.unwrap()
    }

    async fn until(&self, id: &str, wanted: impl Fn(&str) -> bool) -> String {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let text = self.text(id).await;
            if wanted(&text) {
                return text;
            }
            assert!(Instant::now() < deadline, "#{id} is {text:?}");
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }

    async fn press(&self, id: &str) {
        self.0.find(Locator::Id(id)).await.unwrap().click().await.unwrap();
    }

    /// Presses a button again and again until it is answered so: on a busy machine the first poses may contradict each other, and no table is
    /// written of these.
    async fn press_until_answered(&self, id: &str, wanted: &str) {
        let deadline = Instant::now() + PATIENCE;
        loop {
            self.press(id).await;
            tokio::time::sleep(Duration::from_secs(1)).await;
            let answer = self.text("answer").await;
            if answer.starts_with(wanted) {
                return;
            }
            assert!(Instant::now() < deadline, "{id} is answered by {answer:?}");
        }
    }

    async fn run(&self, script: &str) -> Value {
        self.0.execute(script, vec![]).await.unwrap()
    }

    /// Waits until a script gives what is wanted.
    async fn until_run(&self, what: &str, script: &str, wanted: impl Fn(&Value) -> bool) {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let value = self.run(script).await;
            if wanted(&value) {
                return;
            }
            assert!(Instant::now() < deadline, "{what}: {value}");
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }

    async fn screenshot(&self, name: &str) {
        let picture = self.0.screenshot().await.unwrap();
        assert!(picture.len() > 20_000);
        std::fs::write(format!("{}/{name}.png", env!("CARGO_TARGET_TMPDIR")), picture).unwrap();
    }
}

#[test]
fn figures_change_buttons_work_and_the_console_is_silent() {
    experiment();
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("out");
    // A camera that goes on for as long as the browser takes: a busy machine needs many seconds to start one.
    let began = Instant::now();
    let (camera, encoders) = (camera("127.0.0.1:0", began, 5.0, never), encoder_lines(began));
    let live = start(&output, &camera, &encoders);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let (_driver, client) = browser().await;
        let page = Page(client);
        page.0.goto(&format!("http://{}/", live.address)).await.unwrap();
        visit(&page).await;
        let log = page.0.issue_cmd(ConsoleLog).await.unwrap();
        // The browser logs every refusal: a bent snake is refused as a reference, and a table of poses in doubt is not saved.
        let may_be_refused = ["/api/command/reference", "/api/command/save"];
        let refused = |entry: &&Value| {
            entry["message"].as_str().is_some_and(|text| may_be_refused.iter().any(|path| text.contains(path)))
        };
        let rest: Vec<&Value> = log.as_array().unwrap().iter().filter(|entry| !refused(entry)).collect();
        assert!(rest.is_empty(), "the console has something to say: {rest:?}");
        page.0.close().await.unwrap();
    });
    let state = live.get("/api/state");
    assert!(state["notices"].to_string().contains("begin anew"), "{state:#}");
    assert!(output.join("compensation.csv").exists());
}

async fn visit(page: &Page) {
    page.until("chip-link", |text| text == "page: live").await;
    let first = page.until("measured", |text| text.parse::<u64>().is_ok_and(|n| n >= 2)).await;
    page.until("measured", |text| text != first).await;
    page.until("theta", |text| text.contains('±')).await;
    page.until("eta", |text| text.starts_with("1.")).await;
    let lines = "return document.querySelectorAll('#plot-theta path.line').length";
    page.until_run("the plots are drawn", lines, |count| count.as_u64() >= Some(2)).await;
    let drawn = "return document.getElementById('video').naturalWidth";
    page.until_run("the video is there", drawn, |width| *width == 640).await;
    page.screenshot("live-page").await;

    page.press("pause").await;
    page.until("chip-source", |text| text == "paused").await;
    page.press("pause").await;
    page.until("chip-source", |text| text != "paused").await;
    page.press_until_answered("save", "model and table are in").await;
    page.press("reset").await;
    page.press("ask-no").await;
    page.press("reset").await;
    page.press("ask-yes").await;
    page.until("answer", |text| text == "η and λ begin anew").await;
    // A bent snake is no straight reference, or is one that the next click replaces; either way there is an answer.
    page.press("reference").await;
    page.press("ask-yes").await;
    page.until("answer", |text| text.contains("straight reference")).await;

    // The keyboard reaches every command in turn.
    let reach = "document.activeElement.blur(); const tab = [...document.querySelectorAll('a, button, summary')];
                 return tab.filter((e) => e.tabIndex >= 0 && e.offsetParent !== null).map((e) => e.id || e.className || e.tagName)";
    let reached = page.run(reach).await.to_string();
    for id in ["skip", "pause", "reference", "reset", "save"] {
        assert!(reached.contains(id), "{reached}");
    }
    // A phone's width: nothing sticks out.
    page.0.set_window_size(500, 900).await.unwrap();
    let wide = "return document.documentElement.scrollWidth - document.documentElement.clientWidth";
    tokio::time::sleep(Duration::from_millis(700)).await;
    assert_eq!(page.run(wide).await, 0);
    page.screenshot("live-page-phone").await;
}
