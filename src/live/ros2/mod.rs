//! `live` in a ROS 2 network, without an installation of ROS 2: pictures, joints and a lens come as topics, results go out as topics.
//!
//! ROS 2 speaks DDS; [`node`] is the part that does, by RustDDS. Messages are the bytes that recordings have, decoded and encoded by
//! [`crate::bag`]. [`pictures`] and [`joints`] are streams beside the others of `live`, and [`sink`] is beside the HTTP server: it reads the
//! same shared state and asks the same whether anything may be commanded by.
//!
//! Source: ROS 2's design documents "Topic and Service name mapping to DDS" and "Mapping between ROS interface types and DDS IDL types".

mod joint_assembler;
mod joints;
mod node;
mod pictures;
mod sink;
mod sole_publisher;
mod subscription;

pub use node::Node;
pub use sink::Sink;
