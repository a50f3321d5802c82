#include <cstdlib>
#include <exception>
#include <iostream>
#include <map>
#include <memory>
#include <opencv2/core.hpp>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgproc.hpp>
#include <sstream>
#include <string>

#include "apps/command_line.h"
#include "apps/video_frames/frame_source.h"
#include "dfr/core/error.h"

namespace dfr::apps {
namespace {

struct Request {
  int camera = 0;
  std::int64_t first = 0;
  std::int64_t count = 0;
  double fps = 0.0;
  cv::Size size;
  cv::Size out;
  std::string file;
};

Request ParseRequest(const std::string& line) {
  Request r;
  std::istringstream in(line);
  in >> r.camera >> r.first >> r.count >> r.fps >> r.size.height >> r.size.width >> r.out.height >>
      r.out.width;
  in.get();
  std::getline(in, r.file);
  const bool good = in && r.first >= 0 && r.count >= 0 && r.fps > 0.0 && r.out.height > 0 &&
                    r.out.width > 0 && r.out.height <= r.size.height &&
                    r.out.width <= r.size.width && !r.file.empty();
  if (!good) throw core::Error("invalid request", "video_frames --help describes the format");
  return r;
}

// Writes the frames of a request, one at a time.
void Answer(const Request& request, std::unique_ptr<FrameSource>& source) {
  if (!source || source->file() != request.file || source->next() > request.first) {
    source = std::make_unique<FrameSource>(request.file);
  }
  source->Require(request.size, request.fps);
  source->Skip(request.first);
  cv::Mat reduced;
  cv::Mat rgb;
  for (std::int64_t i = 0; i < request.count; ++i) {
    cv::resize(source->Take(), reduced, request.out, 0.0, 0.0, cv::INTER_AREA);
    cv::cvtColor(reduced, rgb, cv::COLOR_BGR2RGB);
    std::cout.put('+');
    std::cout.write(reinterpret_cast<const char*>(rgb.data),
                    static_cast<std::streamsize>(rgb.total() * rgb.elemSize()));
  }
}

void Serve() {
  std::map<int, std::unique_ptr<FrameSource>> sources;  // By camera.
  for (std::string line; std::getline(std::cin, line);) {
    int camera = -1;
    try {
      const Request request = ParseRequest(line);
      camera = request.camera;
      Answer(request, sources[camera]);
    } catch (const std::exception& e) {
      sources.erase(camera);
      std::string text = e.what();
      for (char& c : text) c = c == '\n' ? ' ' : c;
      std::cout << '-' << text << '\n';
    }
    std::cout.flush();
  }
}

int Main(int argc, char** argv) {
  CLI::App app(
      "Decodes frames of videos for other programs, such as guard, which then need no library for\n"
      "videos. Each line of the input requests frames of a file:\n\n"
      "  CAMERA FIRST COUNT FPS HEIGHT WIDTH OUT_HEIGHT OUT_WIDTH FILE\n\n"
      "Frames FIRST to FIRST + COUNT - 1 of a video with FPS frames per second of HEIGHT x WIDTH\n"
      "pixels are averaged to OUT_HEIGHT x OUT_WIDTH. For each one the output has '+' and its\n"
      "bytes, RGB, rows from the top; or '-', the reason and a line break. The last file of each\n"
      "CAMERA, a number, stays open.",
      "video_frames");
  AddVersion(app);
  if (const auto status = Parse(app, argc, argv)) return *status;
  // Files are untrusted and must not make FFmpeg open a network address. This program reports all
  // errors itself.
  setenv("OPENCV_FFMPEG_CAPTURE_OPTIONS", "protocol_whitelist;file", 1);
  setenv("OPENCV_FFMPEG_LOGLEVEL", "-8", 1);
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  std::ios::sync_with_stdio(false);
  Serve();
  return EXIT_SUCCESS;
}

}  // namespace
}  // namespace dfr::apps

int main(int argc, char** argv) {
  return dfr::apps::RunProgram("video_frames", argc, argv, dfr::apps::Main);
}
