//! Threads of low priority, for work that must not hold up the loop.

/// By how much such a thread is nicer than others. Convention: about half of what a Unix system allows.
#[cfg(target_os = "linux")]
/// Convention: a priority of the operating system.
const NICENESS: i32 = 10;

/// Lowers the priority of the calling thread, where the system can.
pub fn lower_priority() {
    // On Linux the niceness is the calling thread's alone. Elsewhere it would be the whole process's.
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(NICENESS);
}

/// Does something on one thread of low priority, and not on all cores, which the loop needs.
pub fn on_one_thread<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    match rayon::ThreadPoolBuilder::new().num_threads(1).start_handler(|_| lower_priority()).build() {
        Ok(pool) => pool.install(work),
        Err(_) => work(),
    }
}
