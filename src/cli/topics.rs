//! Options of `live` for the topics of a ROS 2 network.

use super::live::positive;
use crate::Result;
use crate::cli::failure::Failure;
use crate::live::ReadingStream;
use crate::live::ros2::Node;

/// Which topics.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "ROS 2")]
pub struct TopicArgs {
    /// Join a ROS 2 network: publish bend, η, λ and verdict there, and take pictures and joints from its topics. Needs a build with
    /// `--features ros2`
    #[arg(long)]
    pub ros2: bool,
    /// The topic that pictures come from: sensor_msgs/Image or CompressedImage. If the experiment names no camera file, the lens is
    /// that of the camera_info beside it
    #[arg(long, value_name = "TOPIC", requires = "ros2", conflicts_with_all = ["camera", "source"])]
    pub image_topic: Option<String>,
    /// The topic that encoder readings come from: sensor_msgs/JointState
    #[arg(long, value_name = "TOPIC", requires_all = ["ros2", "joints"])]
    joint_topic: Option<String>,
    /// The joint of each backbone, in order: b1,b2,b3
    #[arg(long, value_name = "NAMES", value_delimiter = ',', requires = "joint_topic")]
    joints: Vec<String>,
    /// What one unit of a joint's position is, mm [default: 1000, for joints in m]
    #[arg(long, value_name = "MM", value_parser = positive, requires = "joint_topic")]
    mm_per_unit: Option<f64>,
    /// The ROS 2 domain [default: that of ROS_DOMAIN_ID, else 0]
    #[arg(long, value_name = "NUMBER", value_parser = clap::value_parser!(u16).range(..=MOST_DOMAIN), requires = "ros2")]
    domain: Option<u16>,
}

/// The largest domain: further ones have no UDP ports.
///
/// Source: OMG DDSI-RTPS 2.5, section 9.6.2.3: port 7400 + 250 × domain.
const MOST_DOMAIN: i64 = 232;
/// What one unit of a joint's position is, mm. Convention: ROS's REP 103, lengths in m.
const MM_PER_M: f64 = 1000.0;

impl TopicArgs {
    /// The domain to join, if one is to be joined.
    ///
    /// # Errors
    /// A ROS_DOMAIN_ID that is none.
    pub fn domain(&self) -> Result<Option<u16>, Failure> {
        let of_environment = || match std::env::var("ROS_DOMAIN_ID") {
            Ok(text) if !text.is_empty() => {
                let domain = text.parse().ok().filter(|domain| i64::from(*domain) <= MOST_DOMAIN);
                domain.ok_or_else(|| Failure::Usage(format!("ROS_DOMAIN_ID is {text:?}, expected 0 to {MOST_DOMAIN}")))
            }
            _ => Ok(0),
        };
        match (self.ros2, self.domain) {
            (false, _) => Ok(None),
            (true, Some(domain)) => Ok(Some(domain)),
            (true, None) => of_environment().map(Some),
        }
    }

    /// The joints of a robot with so many backbones, if they are to be read.
    ///
    /// # Errors
    /// As many joints as the robot has no backbones.
    pub fn joints(&self, node: &Node, backbones: usize) -> Result<Option<Box<dyn ReadingStream>>, Failure> {
        let Some(topic) = &self.joint_topic else { return Ok(None) };
        if self.joints.len() != backbones {
            let joints = self.joints.join(",");
            return Err(Failure::Usage(format!("--joints {joints}: expected {backbones}, one for each backbone")));
        }
        Ok(Some(node.joints(topic, &self.joints, self.mm_per_unit.unwrap_or(MM_PER_M))?))
    }
}
