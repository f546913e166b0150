"""An RTSP camera on the loopback: shows the picture of the moment of a closed path, 15 times a second, as H.264.

Needs Debian's gir1.2-gst-rtsp-server-1.0, python3-gi, gstreamer1.0-plugins-base, -good and -ugly; with `--check` it only says whether they
are there. Called as `rtsp.py FRAMES BEGAN_UNIX_S ROUND_S`; prints the port as soon as it serves.
"""

import sys
import time
from pathlib import Path

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer

RATE_FPS = 15
LAUNCH = (
    f"( appsrc name=frames is-live=true do-timestamp=true format=time caps=image/jpeg,framerate={RATE_FPS}/1 ! jpegdec ! videoconvert "
    "! video/x-raw,format=I420 ! x264enc tune=zerolatency speed-preset=veryfast quantizer=16 pass=qual key-int-max=15 ! rtph264pay name=pay0 pt=96 )"
)

Gst.init(None)
for element in ("appsrc", "jpegdec", "x264enc", "rtph264pay"):
    if Gst.ElementFactory.find(element) is None:
        sys.exit(f"no {element}")
if sys.argv[1] == "--check":
    sys.exit(0)
pictures = [path.read_bytes() for path in sorted(Path(sys.argv[1]).glob("*.jpg"))]
began_s, round_s = float(sys.argv[2]), float(sys.argv[3])


def play(_factory, media):
    frames = media.get_element().get_child_by_name("frames")

    def push():
        share = (time.time() - began_s) / round_s
        picture = pictures[int(share * len(pictures)) % len(pictures)]
        return frames.emit("push-buffer", Gst.Buffer.new_wrapped(picture)) == Gst.FlowReturn.OK

    GLib.timeout_add(1000 // RATE_FPS, push)


server = GstRtspServer.RTSPServer()
server.set_address("127.0.0.1")
server.set_service("0")
factory = GstRtspServer.RTSPMediaFactory()
factory.set_launch(LAUNCH)
factory.set_shared(True)
factory.connect("media-configure", play)
server.get_mount_points().add_factory("/snake", factory)
server.attach(None)
print(server.get_bound_port(), flush=True)
GLib.MainLoop().run()
