# Libraries that several programs share, compiled once:
#   dfr_app_video  videos of rollouts
include_guard(GLOBAL)

find_package(OpenCVVideo MODULE)
if(OpenCVVideo_FOUND)
  dfr_add_app_library(dfr_app_video
    SOURCES ${CMAKE_CURRENT_LIST_DIR}/rollout_video.cc ${CMAKE_CURRENT_LIST_DIR}/video_writer.cc
    PUBLIC dfr::control dfr::experiment OpenCVVideo::OpenCVVideo)
endif()
