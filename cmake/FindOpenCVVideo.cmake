# Makes OpenCVVideo::OpenCVVideo from the parts of OpenCV that read and write videos. They need only Debian's
# libopencv-videoio-dev and libopencv-imgproc-dev. OpenCVConfig.cmake comes only with all of OpenCV, including
# its windows.
find_path(OpenCVVideo_INCLUDE_DIR opencv2/videoio.hpp PATH_SUFFIXES opencv4)
find_library(OpenCVVideo_CORE opencv_core)
find_library(OpenCVVideo_IMGPROC opencv_imgproc)
find_library(OpenCVVideo_IMGCODECS opencv_imgcodecs)
find_library(OpenCVVideo_VIDEOIO opencv_videoio)
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(OpenCVVideo REQUIRED_VARS OpenCVVideo_INCLUDE_DIR
  OpenCVVideo_CORE OpenCVVideo_IMGPROC OpenCVVideo_IMGCODECS OpenCVVideo_VIDEOIO)
mark_as_advanced(OpenCVVideo_INCLUDE_DIR OpenCVVideo_CORE OpenCVVideo_IMGPROC
  OpenCVVideo_IMGCODECS OpenCVVideo_VIDEOIO)
if(OpenCVVideo_FOUND AND NOT TARGET OpenCVVideo::OpenCVVideo)
  add_library(OpenCVVideo::OpenCVVideo INTERFACE IMPORTED)
  target_include_directories(OpenCVVideo::OpenCVVideo SYSTEM INTERFACE ${OpenCVVideo_INCLUDE_DIR})
  target_link_libraries(OpenCVVideo::OpenCVVideo INTERFACE
    ${OpenCVVideo_VIDEOIO} ${OpenCVVideo_IMGCODECS} ${OpenCVVideo_IMGPROC} ${OpenCVVideo_CORE})
endif()
