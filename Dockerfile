# The program without OpenCV, and with ROS 2: measures pictures, learns, compensates, discovers. For `live --ros2` add --network host.
#
#   docker build --tag snakeloop .
#   mkdir -p out    # else docker makes it, and root's
#   docker run --rm --user "$(id -u):$(id -g)" --volume "$PWD/fixtures/bending:/experiment:ro" --volume "$PWD/out:/out" snakeloop run /experiment -o /out

FROM rust:1-slim-bookworm AS build
WORKDIR /snakeloop
COPY . .
RUN cargo build --release --locked --no-default-features --features cli,ros2

FROM debian:bookworm-slim
COPY --from=build /snakeloop/target/release/snakeloop /usr/local/bin/
ENTRYPOINT ["snakeloop"]
CMD ["--help"]
