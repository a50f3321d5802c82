// Writes a video of raw frames from the standard input, RGB.
//
// usage: write_video FILE CODEC FPS HEIGHT WIDTH < FRAMES
#include <cstdint>
#include <cstdlib>
#include <iostream>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>
#include <span>

int main(int argc, char** argv) {
  const std::span arguments(argv, static_cast<std::size_t>(argc));
  if (arguments.size() != 6) return 2;
  const char* codec = arguments[2];
  const cv::Size size(std::atoi(arguments[5]), std::atoi(arguments[4]));
  cv::VideoWriter writer(arguments[1], cv::CAP_FFMPEG,
                         cv::VideoWriter::fourcc(codec[0], codec[1], codec[2], codec[3]),
                         std::atof(arguments[3]), size);
  if (!writer.isOpened()) return 1;
  cv::Mat frame(size, CV_8UC3);
  cv::Mat bgr;
  const auto bytes = static_cast<std::streamsize>(frame.total() * frame.elemSize());
  while (std::cin.read(reinterpret_cast<char*>(frame.data), bytes)) {
    cv::cvtColor(frame, bgr, cv::COLOR_RGB2BGR);
    writer.write(bgr);
  }
  return 0;
}
