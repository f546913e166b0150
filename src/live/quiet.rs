//! Work that must not hold up the loop.

/// Lets every other thread of the machine go first, where the system knows how.
pub fn be_quiet() {
    // On Linux this is the calling thread's alone. Elsewhere it would be the whole process's.
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(10);
}

/// Does something on one quiet thread, whatever it would rather spread over: the loop's own work is spread too.
pub fn alone<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    match rayon::ThreadPoolBuilder::new().num_threads(1).start_handler(|_| be_quiet()).build() {
        Ok(pool) => pool.install(work),
        Err(_) => work(),
    }
}
