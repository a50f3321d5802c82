// Writes videos of raw RGB frames. One process writes many, because OpenCV's libraries take 0.2 s
// to load.
//
// usage: write_video < VIDEOS
// Each video is a line "CODEC FPS HEIGHT WIDTH FRAMES FILE", and then its frames.
#include <cstdint>
#include <iostream>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>
#include <string>

int main() {
  std::string codec;
  double fps = 0.0;
  cv::Size size;
  int frames = 0;
  while (std::cin >> codec >> fps >> size.height >> size.width >> frames) {
    std::string file;
    std::getline(std::cin >> std::ws, file);
    cv::VideoWriter writer(file, cv::CAP_FFMPEG,
                           cv::VideoWriter::fourcc(codec[0], codec[1], codec[2], codec[3]), fps,
                           size);
    if (!writer.isOpened()) return 1;
    cv::Mat frame(size, CV_8UC3);
    cv::Mat bgr;
    const auto bytes = static_cast<std::streamsize>(frame.total() * frame.elemSize());
    for (int i = 0; i < frames; ++i) {
      if (!std::cin.read(reinterpret_cast<char*>(frame.data), bytes)) return 1;
      cv::cvtColor(frame, bgr, cv::COLOR_RGB2BGR);
      writer.write(bgr);
    }
  }
  return 0;
}
