# What several programs have in common, compiled once:
#   dfr_app_methods  policies, supports and controllers by name
#   dfr_app_video    films of rollouts
include_guard(GLOBAL)

dfr_add_app_library(dfr_app_methods
  SOURCES ${CMAKE_CURRENT_LIST_DIR}/baselines.cc ${CMAKE_CURRENT_LIST_DIR}/controller_factory.cc
          ${CMAKE_CURRENT_LIST_DIR}/learned_model.cc ${CMAKE_CURRENT_LIST_DIR}/policies.cc
          ${CMAKE_CURRENT_LIST_DIR}/supports.cc
  PUBLIC dfr::kernel dfr::imitation dfr::control dfr::safety dfr::experiment)

find_package(OpenCVVideo MODULE)
if(OpenCVVideo_FOUND)
  dfr_add_app_library(dfr_app_video
    SOURCES ${CMAKE_CURRENT_LIST_DIR}/rollout_video.cc ${CMAKE_CURRENT_LIST_DIR}/video_writer.cc
    PUBLIC dfr::control OpenCVVideo::OpenCVVideo)
endif()
