# Makes OpenCVImgproc::OpenCVImgproc from the parts of OpenCV that work on images in memory. They need
# only Debian's libopencv-imgproc-dev. OpenCVConfig.cmake comes only with all of OpenCV, including its
# windows.
find_path(OpenCVImgproc_INCLUDE_DIR opencv2/imgproc.hpp PATH_SUFFIXES opencv4)
find_library(OpenCVImgproc_CORE opencv_core)
find_library(OpenCVImgproc_IMGPROC opencv_imgproc)
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(OpenCVImgproc REQUIRED_VARS OpenCVImgproc_INCLUDE_DIR
  OpenCVImgproc_CORE OpenCVImgproc_IMGPROC)
mark_as_advanced(OpenCVImgproc_INCLUDE_DIR OpenCVImgproc_CORE OpenCVImgproc_IMGPROC)
if(OpenCVImgproc_FOUND AND NOT TARGET OpenCVImgproc::OpenCVImgproc)
  add_library(OpenCVImgproc::OpenCVImgproc INTERFACE IMPORTED)
  target_include_directories(OpenCVImgproc::OpenCVImgproc SYSTEM INTERFACE
    ${OpenCVImgproc_INCLUDE_DIR})
  target_link_libraries(OpenCVImgproc::OpenCVImgproc INTERFACE
    ${OpenCVImgproc_IMGPROC} ${OpenCVImgproc_CORE})
endif()
