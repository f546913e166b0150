//! Work that must not hold up the loop.

/// Lets every other thread of the machine go first, where the system knows how.
pub fn be_quiet() {
    // On Linux this is the calling thread's alone. Elsewhere it would be the whole process's.
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(10);
}
