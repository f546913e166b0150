//! What the snake looks like: its body as disks and tubes, projected, and the border that a picture shows of it.

pub mod outline;
