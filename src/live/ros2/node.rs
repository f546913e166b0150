//! A participant of a DDS domain: topics and types under ROS 2's names, messages as bytes.

use super::super::stream::{FrameStream, ReadingStream};
use super::joints::Joints;
use super::pictures::{Pictures, lens_of};
use crate::camera::Lens;
use crate::error::{Error, Result};
use rustdds::bytes::Bytes;
use rustdds::no_key::{DataWriter, Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter, SimpleDataReader};
use rustdds::policy::{Durability, History, ResourceLimits};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, Publisher, QosPolicies, QosPolicyBuilder, RepresentationIdentifier,
    Subscriber, Topic, TopicKind,
};
use std::convert::Infallible;
use std::fmt;
use std::net::{IpAddr, Ipv4Addr};

/// What reads the messages of a topic.
pub type Reader = SimpleDataReader<Vec<u8>, Encapsulated>;
/// What writes them.
pub type Writer = DataWriter<Vec<u8>, Encapsulated>;

/// How a topic is published.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// What was lost on its way is sent again, for every kind of reader. Nobody waits for a slow one: it misses what is replaced.
    Reliable,
    /// What was lost is lost, for pictures.
    BestEffort,
}

/// A participant of a domain. Copies of it are the same participant.
#[derive(Clone)]
pub struct Node {
    participant: DomainParticipant,
    publisher: Publisher,
    subscriber: Subscriber,
    domain: u16,
}

impl fmt::Debug for Node {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Node").field("domain", &self.domain).finish_non_exhaustive()
    }
}

impl Node {
    /// Joins a domain. Where ROS 2's environment variables keep discovery to this machine (`ROS_LOCALHOST_ONLY=1`,
    /// `ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST`), nothing is sent to others.
    ///
    /// # Errors
    /// Sockets that cannot be opened.
    pub fn join(domain: u16) -> Result<Self> {
        let wrong = |why: String| Error::Unavailable { what: format!("ROS 2, domain {domain}"), message: why };
        let mut builder = DomainParticipantBuilder::new(domain);
        if is_local_only(|name| std::env::var(name).ok()) {
            builder = builder.with_only_networks([IpAddr::V4(Ipv4Addr::LOCALHOST)]);
        }
        let participant = builder.build().map_err(|e| wrong(e.to_string()))?;
        let none = QosPolicies::qos_none();
        let publisher = participant.create_publisher(&none).map_err(|e| wrong(e.to_string()))?;
        let subscriber = participant.create_subscriber(&none).map_err(|e| wrong(e.to_string()))?;
        Ok(Self { participant, publisher, subscriber, domain })
    }

    /// The domain's number.
    pub fn domain(&self) -> u16 {
        self.domain
    }

    /// The pictures of a topic of `sensor_msgs/Image` or `CompressedImage`.
    ///
    /// # Errors
    /// A thread that cannot be set up.
    pub fn pictures(&self, topic: &str) -> Result<Box<dyn FrameStream>> {
        Ok(Box::new(Pictures::of(self, topic)?))
    }

    /// The positions of these joints on a topic of `sensor_msgs/JointState`, one for each backbone.
    ///
    /// # Errors
    /// A thread that cannot be set up.
    pub fn joints(&self, topic: &str, joints: &[String], mm_per_unit: f64) -> Result<Box<dyn ReadingStream>> {
        Ok(Box::new(Joints::of(self, topic, joints, mm_per_unit)?))
    }

    /// The lens that the camera of an image topic tells by its `sensor_msgs/CameraInfo`, waited for.
    ///
    /// # Errors
    /// No message in time; a camera that was not calibrated, or one of another model.
    pub fn lens_beside(&self, image_topic: &str) -> Result<Lens> {
        lens_of(self, image_topic)
    }

    /// The types that others publish a topic as, as ROS 2 names them (`sensor_msgs/Image`), each once.
    pub fn kinds_of(&self, topic: &str) -> Vec<String> {
        let name = topic_in_dds(topic);
        let writers = self.participant.discovered_writers().into_iter();
        let of_topic = writers.map(|writer| writer.publication_topic_data).filter(|data| data.topic_name == name);
        let mut kinds: Vec<String> = of_topic.map(|data| kind_in_ros(&data.type_name)).collect();
        kinds.sort();
        kinds.dedup();
        kinds
    }

    /// A reader of a topic for sensor data: what it does not take in time is lost, and the publisher never waits for it. `depth` messages are
    /// kept for it.
    ///
    /// # Errors
    /// A topic that cannot be made.
    pub fn reader(&self, topic: &str, kind: &str, depth: i32) -> Result<Reader> {
        let qos = sensor_data(depth);
        let topic_in_dds = self.topic(topic, kind, &qos)?;
        self.subscriber
            .create_simple_datareader_no_key(&topic_in_dds, Some(qos))
            .map_err(|e| unavailable(topic, &e.to_string()))
    }

    /// A writer of a topic.
    ///
    /// # Errors
    /// A topic that cannot be made.
    pub fn writer(&self, topic: &str, kind: &str, delivery: Delivery) -> Result<Writer> {
        let qos = QosPolicyBuilder::new().durability(Durability::Volatile).history(History::KeepLast { depth: KEPT });
        let qos = match delivery {
            Delivery::Reliable => qos.reliable(rustdds::Duration::ZERO),
            Delivery::BestEffort => qos.best_effort(),
        };
        let qos = qos.build();
        let topic_in_dds = self.topic(topic, kind, &qos)?;
        self.publisher
            .create_datawriter_no_key(&topic_in_dds, Some(qos))
            .map_err(|e| unavailable(topic, &e.to_string()))
    }

    fn topic(&self, topic: &str, kind: &str, qos: &QosPolicies) -> Result<Topic> {
        self.participant
            .create_topic(topic_in_dds(topic), kind_in_dds(kind), qos, TopicKind::NoKey)
            .map_err(|e| unavailable(topic, &e.to_string()))
    }
}

/// Messages that a writer keeps for readers that lost one. Convention: as ROS 2's default.
const KEPT: i32 = 10;

/// Best effort, volatile, the last messages only: ROS 2's profile for sensor data.
fn sensor_data(depth: i32) -> QosPolicies {
    QosPolicyBuilder::new()
        .best_effort()
        .durability(Durability::Volatile)
        .history(History::KeepLast { depth })
        // Else RustDDS keeps 64 of them, which are pictures.
        .resource_limits(ResourceLimits { max_samples: depth, max_instances: 1, max_samples_per_instance: depth })
        .build()
}

fn unavailable(topic: &str, message: &str) -> Error {
    Error::Unavailable { what: format!("ROS 2, topic {topic}"), message: message.to_owned() }
}

/// Whether ROS 2's environment keeps discovery to this machine.
fn is_local_only(variable: impl Fn(&str) -> Option<String>) -> bool {
    variable("ROS_LOCALHOST_ONLY").as_deref() == Some("1")
        || variable("ROS_AUTOMATIC_DISCOVERY_RANGE").is_some_and(|range| range.eq_ignore_ascii_case("localhost"))
}

/// `/camera/image_raw` as DDS knows it: `rt/camera/image_raw`.
fn topic_in_dds(topic: &str) -> String {
    format!("rt/{}", topic.trim_start_matches('/'))
}

/// `sensor_msgs/Image` as DDS knows it: `sensor_msgs::msg::dds_::Image_`.
fn kind_in_dds(kind: &str) -> String {
    match kind.split_once('/') {
        Some((package, name)) => format!("{package}::msg::dds_::{name}_"),
        None => kind.to_owned(),
    }
}

/// A type as ROS 2 names it, as far as it is one of ROS 2.
fn kind_in_ros(kind: &str) -> String {
    match kind.split_once("::msg::dds_::") {
        Some((package, name)) => format!("{package}/{}", name.trim_end_matches('_')),
        None => kind.to_owned(),
    }
}

/// Messages as recordings have them: behind the four bytes that say their encoding.
pub struct Encapsulated;

/// Takes a message as it is.
#[derive(Clone)]
pub struct AsItIs;

impl DeserializerAdapter<Vec<u8>> for Encapsulated {
    type Error = Infallible;
    type Decoded = Vec<u8>;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE, RepresentationIdentifier::CDR_BE]
    }

    fn transform_decoded(decoded: Vec<u8>) -> Vec<u8> {
        decoded
    }
}

impl DefaultDecoder<Vec<u8>> for Encapsulated {
    type Decoder = AsItIs;
    const DECODER: AsItIs = AsItIs;
}

impl Decode<'_, Vec<u8>> for AsItIs {
    type Error = Infallible;

    fn decode_bytes(self, bytes: &[u8], encoding: RepresentationIdentifier) -> Result<Vec<u8>, Infallible> {
        let [first, second] = encoding.to_bytes();
        Ok([&[first, second, 0, 0], bytes].concat())
    }
}

impl SerializerAdapter<Vec<u8>> for Encapsulated {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(message: &Vec<u8>) -> Result<Bytes, Infallible> {
        Ok(Bytes::copy_from_slice(message.get(4..).unwrap_or_default()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_ros_2_on_the_wire() {
        assert_eq!(topic_in_dds("/camera/image_raw"), "rt/camera/image_raw");
        assert_eq!(topic_in_dds("joint_states"), "rt/joint_states");
        assert_eq!(kind_in_dds("sensor_msgs/Image"), "sensor_msgs::msg::dds_::Image_");
        assert_eq!(kind_in_ros("sensor_msgs::msg::dds_::JointState_"), "sensor_msgs/JointState");
        assert_eq!(kind_in_ros("HelloWorld"), "HelloWorld");
    }

    #[test]
    fn the_environment_of_ros_2_keeps_discovery_to_the_machine() {
        let with = |name: &'static str, value: &'static str| {
            is_local_only(move |asked| (asked == name).then(|| value.to_owned()))
        };
        assert!(with("ROS_LOCALHOST_ONLY", "1") && with("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"));
        assert!(!with("ROS_LOCALHOST_ONLY", "0") && !with("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"));
    }
}
