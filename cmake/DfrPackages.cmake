# Describes the components to pkg-config and dpkg: dfr_write_pkg_config for each library, and
# dfr_describe_packages, from which `cpack -G DEB` (./dev package) makes one package per component.

# Names of dependencies in CMake, with their pkg-config modules or flags.
set(DFR_PKG_CONFIG_MODULES
  "Eigen3::Eigen=eigen3" "hwy::hwy=libhwy" "hdf5::hdf5=hdf5-serial" "OpenSSL::Crypto=libcrypto"
  "Snappy::snappy=snappy" "Snappy::snappy-static=snappy" "zstd::libzstd_shared=libzstd" "zstd::libzstd_static=libzstd")
set(DFR_PKG_CONFIG_FLAGS
  "Threads::Threads=-pthread" "dl=-ldl" "Ceres::ceres=-lceres -lglog" "mujoco::mujoco=-lmujoco"
  "nlohmann_json::nlohmann_json=" "fastrtps=-lfastrtps" "fastcdr=-lfastcdr"
  "OpenCVImgproc::OpenCVImgproc=-lopencv_imgproc -lopencv_core"
  "OpenCVVideo::OpenCVVideo=-lopencv_videoio -lopencv_imgcodecs -lopencv_imgproc -lopencv_core"
  "libjpeg-turbo::turbojpeg=-lturbojpeg")

# dfr_write_pkg_config(kernel dfr::core Eigen3::Eigen hwy::hwy ...) writes and installs dfr-kernel.pc.
# The libraries are static. Linking a static library also requires its private dependencies. Requires
# and Libs therefore list all of them.
function(dfr_write_pkg_config name)
  set(requires "")
  set(flags "")
  foreach(item IN LISTS ARGN)
    set(modules ${DFR_PKG_CONFIG_MODULES})
    list(FILTER modules INCLUDE REGEX "^${item}=")
    set(known ${DFR_PKG_CONFIG_FLAGS})
    list(FILTER known INCLUDE REGEX "^${item}=")
    if(item MATCHES "^dfr::(.*)$")
      list(APPEND requires "dfr-${CMAKE_MATCH_1} = ${PROJECT_VERSION}")
    elseif(modules)
      string(REGEX REPLACE "^.*=" "" module ${modules})
      list(APPEND requires ${module})
    elseif(known)
      string(REGEX REPLACE "^[^=]*=" "" flag ${known})
      list(APPEND flags ${flag})
    else()
      message(SEND_ERROR "dfr_${name} links ${item}: add its pkg-config module or flags to "
                         "cmake/DfrPackages.cmake")
    endif()
  endforeach()
  list(REMOVE_DUPLICATES requires)
  list(JOIN requires ", " requires)
  list(JOIN flags " " flags)
  string(REPLACE "_" "-" module ${name})
  string(REPLACE "_" "-" requires "${requires}")
  file(RELATIVE_PATH prefix /prefix/${CMAKE_INSTALL_LIBDIR}/pkgconfig /prefix)
  string(REGEX REPLACE "/$" "" prefix ${prefix})
  # Paths are relative to the file, because the installed folder may be moved.
  file(CONFIGURE OUTPUT ${CMAKE_CURRENT_BINARY_DIR}/dfr-${module}.pc @ONLY CONTENT
[[prefix=${pcfiledir}/@prefix@
libdir=${prefix}/@CMAKE_INSTALL_LIBDIR@
includedir=${prefix}/@CMAKE_INSTALL_INCLUDEDIR@

Name: dfr-@module@
Description: @PROJECT_DESCRIPTION@: the library dfr::@name@
Version: @PROJECT_VERSION@
Requires: @requires@
Libs: -L${libdir} -ldfr_@name@ @flags@
Cflags: -std=c++20 -DEIGEN_MPL2_ONLY -I${includedir}
]])
  install(FILES ${CMAKE_CURRENT_BINARY_DIR}/dfr-${module}.pc
    DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig COMPONENT ${name})
endfunction()

# Sets result to the name of the Debian package that a component becomes.
function(dfr_debian_name name result)
  string(REPLACE "_" "-" package ${name})
  if(name IN_LIST libraries)
    set(${result} libdfr-${package}-dev PARENT_SCOPE)
  elseif(name STREQUAL "python")
    set(${result} python3-dfr PARENT_SCOPE)
  else()
    set(${result} dfr-${package} PARENT_SCOPE)
  endif()
endfunction()

# Sets result to TRUE if the packages of the component, or of a component that it needs, match the pattern.
function(dfr_reaches name pattern result)
  set(${result} FALSE PARENT_SCOPE)
  if("${component_${name}_packages}" MATCHES "${pattern}")
    set(${result} TRUE PARENT_SCOPE)
    return()
  endif()
  foreach(need IN LISTS component_${name}_needs)
    dfr_reaches(${need} "${pattern}" found)
    if(found)
      set(${result} TRUE PARENT_SCOPE)
      return()
    endif()
  endforeach()
endfunction()

# Installs /usr/share/doc/<package>/copyright in Debian's machine-readable format, made from LICENSE.
function(dfr_install_copyright name package)
  file(STRINGS ${PROJECT_SOURCE_DIR}/LICENSE lines)
  set(license "")
  foreach(line IN LISTS lines)
    if(line STREQUAL "")
      set(line ".")
    endif()
    string(APPEND license " ${line}\n")
  endforeach()
  string(STRIP "${license}" license)
  set(license " ${license}")
  set(comment "The source of this package is under the BSD 3-Clause License alone.")
  # Debian's Ceres links to GPL parts of SuiteSparse, and OpenCV's videoio to FFmpeg (third_party_licenses/README.md).
  dfr_reaches(${name} "libceres-dev|libopencv-videoio-dev" gpl)
  if(gpl)
    string(APPEND comment "\n A binary that links this package's libraries, or is one of its programs,"
      "\n contains or loads GPL code through Debian's Ceres Solver (SuiteSparse) or"
      "\n OpenCV (FFmpeg), and may be distributed only under the GPL, version 3 or later.")
  endif()
  set(file ${PROJECT_BINARY_DIR}/copyright/${name}/copyright)
  configure_file(${PROJECT_SOURCE_DIR}/cmake/copyright.in ${file} @ONLY)
  install(FILES ${file} DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/${package} COMPONENT ${name})
endfunction()

# Lists the Debian packages that a component and its needs are built with, except tools that leave
# nothing in the result.
function(dfr_built_with name result)
  string(REGEX MATCHALL "[^ ]+" packages "${component_${name}_packages} ${component_${name}_build_packages}")
  list(REMOVE_ITEM packages fastddsgen default-jre-headless python3)
  foreach(need IN LISTS component_${name}_needs)
    dfr_built_with(${need} needed)
    list(APPEND packages ${needed})
  endforeach()
  list(REMOVE_DUPLICATES packages)
  set(${result} "${packages}" PARENT_SCOPE)
endfunction()

# dfr_describe_packages(core kernel ...) describes the packages of components, which are given in the order
# of components.txt. A library's package depends on the needs of its row. The packages of programs and of the
# Python module depend on the shared libraries that dpkg-shlibdeps finds in them.
function(dfr_describe_packages)
  if(NOT PROJECT_IS_TOP_LEVEL)
    return()
  endif()
  get_property(libraries GLOBAL PROPERTY DFR_LIBRARIES)
  dfr_read_components(component)
  set(CPACK_COMPONENTS_ALL ${ARGN})
  set(CPACK_GENERATOR DEB)
  set(CPACK_DEB_COMPONENT_INSTALL ON)
  set(CPACK_COMPONENTS_GROUPING IGNORE)
  set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
  set(CPACK_PACKAGE_NAME dfr)
  set(CPACK_PACKAGE_VENDOR dfr)
  set(CPACK_PACKAGE_DESCRIPTION_SUMMARY "${PROJECT_DESCRIPTION}")
  set(CPACK_STRIP_FILES ON)
  set(CPACK_PRE_BUILD_SCRIPTS ${PROJECT_SOURCE_DIR}/cmake/CopyCopyrights.cmake)
  set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
  set(CPACK_DEBIAN_PACKAGE_MAINTAINER "The dfr maintainers <maintainers@dfr.invalid>")
  set(CPACK_DEBIAN_PACKAGE_CONTROL_STRICT_PERMISSION ON)
  foreach(name IN LISTS ARGN)
    string(TOUPPER ${name} id)
    dfr_debian_name(${name} package)
    set(CPACK_DEBIAN_${id}_PACKAGE_NAME ${package})
    dfr_install_copyright(${name} ${package})
    dfr_built_with(${name} CPACK_DFR_${id}_BUILT_WITH)
    set(CPACK_DEBIAN_${id}_DESCRIPTION "${PROJECT_DESCRIPTION}: ${name}")
    if(name IN_LIST libraries)
      string(REGEX REPLACE " +" ";" depends "${component_${name}_packages}")
      foreach(need IN LISTS component_${name}_needs)
        dfr_debian_name(${need} needed)
        list(APPEND depends "${needed} (= ${PROJECT_VERSION})")
      endforeach()
      list(JOIN depends ", " depends)
      set(CPACK_DEBIAN_${id}_PACKAGE_DEPENDS "${depends}")
      set(CPACK_DEBIAN_${id}_PACKAGE_SECTION libdevel)
    else()
      set(CPACK_DEBIAN_${id}_PACKAGE_SHLIBDEPS ON)
      # dpkg-shlibdeps does not find the libraries that mujoco_view opens at run time.
      dfr_reaches(${name} "libosmesa6-dev" draws)
      if(draws)
        set(CPACK_DEBIAN_${id}_PACKAGE_DEPENDS "libosmesa6, libegl1")
      endif()
      # Recommends the programs that a program starts.
      set(recommends "")
      foreach(need IN LISTS component_${name}_needs)
        if(NOT need IN_LIST libraries)
          dfr_debian_name(${need} needed)
          list(APPEND recommends ${needed})
        endif()
      endforeach()
      list(JOIN recommends ", " recommends)
      set(CPACK_DEBIAN_${id}_PACKAGE_RECOMMENDS "${recommends}")
      set(CPACK_DEBIAN_${id}_PACKAGE_SECTION science)
    endif()
    if(name STREQUAL "guard")  # starts video_frames for LeRobot's videos
      set(CPACK_DEBIAN_${id}_PACKAGE_SUGGESTS dfr-video-frames)
    endif()
    if(name STREQUAL "python")
      # A module is built for one minor version of Python.
      get_property(version GLOBAL PROPERTY DFR_PYTHON_VERSION)
      string(REPLACE "." ";" parts ${version})
      list(GET parts 1 minor)
      math(EXPR next "${minor} + 1")
      set(CPACK_DEBIAN_PYTHON_PACKAGE_DEPENDS
        "python3 (>= ${version}), python3 (<< 3.${next}), python3-numpy")
      set(CPACK_DEBIAN_PYTHON_PACKAGE_SUGGESTS "python3-sklearn, dfr-video-frames")
      set(CPACK_DEBIAN_PYTHON_PACKAGE_SECTION python)
    endif()
  endforeach()
  include(CPack)
endfunction()
