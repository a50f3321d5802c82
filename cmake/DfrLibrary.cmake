# Defines the targets of this repository: dfr_add_library, dfr_add_app, dfr_add_bench, dfr_embed.

if(NOT CMAKE_BUILD_TYPE AND NOT CMAKE_CONFIGURATION_TYPES)
  set(CMAKE_BUILD_TYPE Release CACHE STRING "Build type" FORCE)
endif()
if(PROJECT_IS_TOP_LEVEL)
  set(CMAKE_RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/bin)
  set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
endif()
if(NOT CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  # CMake gives a precompiled header one name for C and C++. A folder with C may have another compiler for C.
  set(DFR_PRECOMPILE OFF)
elseif(DFR_PRECOMPILE)
  # GCC collects garbage only above a heap of 1 GiB. A large unit then compiles in a seventh less time.
  add_compile_options(--param=ggc-min-heapsize=1048576 --param=ggc-min-expand=300)
  # gold links the test programs in a third of the time of bfd. Both come with binutils.
  find_program(DFR_GOLD ld.gold)
  if(DFR_GOLD)
    add_link_options(-fuse-ld=gold)
  endif()
endif()
set(THREADS_PREFER_PTHREAD_FLAG ON)
find_package(Threads REQUIRED)

# Warnings and sanitizers are for this build only. Consumers never inherit them.
add_library(dfr_build_flags INTERFACE)
target_compile_options(dfr_build_flags INTERFACE
  -Wall -Wextra -Wpedantic -Wshadow -Wnon-virtual-dtor -Woverloaded-virtual
  $<$<BOOL:${DFR_WERROR}>:-Werror>
  # Sources that are compiled as one unit share its anonymous namespace. GCC and Clang report different effects.
  $<$<AND:$<CXX_COMPILER_ID:GNU>,$<BOOL:${CMAKE_UNITY_BUILD}>>:-Wno-subobject-linkage>
  $<$<AND:$<CXX_COMPILER_ID:Clang>,$<BOOL:${CMAKE_UNITY_BUILD}>>:-Wno-shadow>)
if(DFR_SANITIZE)
  target_compile_options(dfr_build_flags INTERFACE -fsanitize=${DFR_SANITIZE} -fno-omit-frame-pointer)
  target_link_options(dfr_build_flags INTERFACE -fsanitize=${DFR_SANITIZE})
endif()

if(DFR_FUZZ)
  if(NOT CMAKE_CXX_COMPILER_ID STREQUAL "Clang")
    message(FATAL_ERROR "DFR_FUZZ needs clang: cmake --preset fuzz chooses it")
  endif()
  target_compile_options(dfr_build_flags INTERFACE -fsanitize=fuzzer-no-link)
endif()

# Headers that most sources include are parsed once for each kind of target: library, offline (a library that
# needs no speed), command_line (a program with a command line) and test. A program without a command line
# shares the headers of a kind of library. A build without DFR_PRECOMPILE, such as a sanitized one, fails if
# a source does not include a header that it needs.
if(DFR_PRECOMPILE)
  find_package(Eigen3 REQUIRED NO_MODULE)
  file(CONFIGURE OUTPUT ${PROJECT_BINARY_DIR}/precompiled.cc CONTENT "")
endif()
if(DFR_QUICK)
  foreach(kind IN ITEMS offline program command_line test)
    set(DFR_OPTIONS_OF_${kind} -Og)
  endforeach()
elseif(DFR_QUICK_OFFLINE)
  set(DFR_OPTIONS_OF_offline -Og)
  set(DFR_OPTIONS_OF_command_line -Og)
endif()
function(dfr_add_precompiled name)
  if(NOT DFR_PRECOMPILE)
    return()
  endif()
  add_library(dfr_precompiled_${name} OBJECT ${PROJECT_BINARY_DIR}/precompiled.cc)
  target_compile_features(dfr_precompiled_${name} PRIVATE cxx_std_20)
  target_compile_options(dfr_precompiled_${name} PRIVATE ${DFR_OPTIONS_OF_${name}})
  target_compile_definitions(dfr_precompiled_${name} PRIVATE EIGEN_MPL2_ONLY)
  target_link_libraries(dfr_precompiled_${name} PRIVATE Eigen3::Eigen dfr_build_flags)
  target_precompile_headers(dfr_precompiled_${name} PRIVATE
    <Eigen/Core> <Eigen/Geometry> <algorithm> <array> <cmath> <cstdint> <filesystem> <functional> <iostream>
    <map> <memory> <optional> <random> <set> <span> <sstream> <stdexcept> <string> <string_view> <utility>
    <vector> ${ARGN})
endfunction()
foreach(kind IN ITEMS library offline)
  if(kind STREQUAL library OR DFR_OPTIONS_OF_${kind})
    dfr_add_precompiled(${kind})
    if(DFR_PRECOMPILE)
      set_target_properties(dfr_precompiled_${kind} PROPERTIES POSITION_INDEPENDENT_CODE ON)
    endif()
  endif()
endforeach()
# CLI11's header costs the compiler 3 s in each source, even in one that only includes it.
find_package(CLI11 QUIET)
if(CLI11_FOUND)
  dfr_add_precompiled(command_line <CLI/CLI.hpp>)
  if(DFR_PRECOMPILE)
    target_link_libraries(dfr_precompiled_command_line PRIVATE CLI11::CLI11)
  endif()
else()
  dfr_add_precompiled(command_line)
endif()

# dfr_use_precompiled(target library|offline|program|command_line|test)
function(dfr_use_precompiled target kind)
  target_compile_options(${target} PRIVATE ${DFR_OPTIONS_OF_${kind}})
  if(DFR_PRECOMPILE)
    if(NOT TARGET dfr_precompiled_${kind})  # reuses the headers of a kind with the same options
      if(DFR_OPTIONS_OF_${kind})
        set(kind offline)
      else()
        set(kind library)
      endif()
      set_target_properties(${target} PROPERTIES POSITION_INDEPENDENT_CODE ON)
    endif()
    target_precompile_headers(${target} REUSE_FROM dfr_precompiled_${kind})
  endif()
endfunction()

# dfr_add_library(kernel SOURCES ... [PUBLIC ...] [PRIVATE ...] [OFFLINE])
# makes dfr_kernel, its alias dfr::kernel, the install component and export set "kernel", and
# dfr-kernel.pc. OFFLINE marks a library that no control loop and no fit calls, such as a library for
# files and reports. Public headers are in include/ next to CMakeLists.txt.
function(dfr_add_library name)
  cmake_parse_arguments(PARSE_ARGV 1 arg "OFFLINE" "" "SOURCES;PUBLIC;PRIVATE")
  set(target dfr_${name})
  add_library(${target} STATIC ${arg_SOURCES})
  add_library(dfr::${name} ALIAS ${target})
  set_target_properties(${target} PROPERTIES EXPORT_NAME ${name} POSITION_INDEPENDENT_CODE ON)
  target_compile_features(${target} PUBLIC cxx_std_20)
  target_compile_definitions(${target} PUBLIC EIGEN_MPL2_ONLY)
  target_include_directories(${target} PUBLIC
    $<BUILD_INTERFACE:${CMAKE_CURRENT_SOURCE_DIR}/include>
    $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>)
  target_link_libraries(${target} PUBLIC ${arg_PUBLIC} PRIVATE ${arg_PRIVATE}
    $<BUILD_INTERFACE:dfr_build_flags>)
  if(arg_OFFLINE)
    dfr_use_precompiled(${target} offline)
  else()
    dfr_use_precompiled(${target} library)
  endif()
  if(DFR_COVERAGE)
    target_compile_options(${target} PRIVATE --coverage -fprofile-update=atomic)
    target_link_options(${target} INTERFACE $<BUILD_INTERFACE:--coverage>)
  endif()
  install(TARGETS ${target} EXPORT dfr_${name}
    ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT ${name})
  install(DIRECTORY include/ DESTINATION ${CMAKE_INSTALL_INCLUDEDIR} COMPONENT ${name})
  install(EXPORT dfr_${name} NAMESPACE dfr:: FILE dfr_${name}.cmake
    DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/dfr COMPONENT ${name})
  dfr_write_pkg_config(${name} ${arg_PUBLIC} ${arg_PRIVATE})
  set_property(GLOBAL APPEND PROPERTY DFR_LIBRARIES ${name})
endfunction()

# dfr_add_app_library(dfr_pusher_app SOURCES ... PUBLIC ... [PRIVATE ...]) makes a library from a program's
# sources without its command line, for tests and other programs.
function(dfr_add_app_library target)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "" "SOURCES;PUBLIC;PRIVATE")
  add_library(${target} STATIC ${arg_SOURCES})
  target_compile_features(${target} PUBLIC cxx_std_20)
  target_include_directories(${target} PUBLIC ${PROJECT_SOURCE_DIR})
  target_link_libraries(${target} PUBLIC ${arg_PUBLIC} PRIVATE ${arg_PRIVATE} dfr_build_flags)
  dfr_use_precompiled(${target} program)
endfunction()

# dfr_install_completions(program component) installs completion of the program's arguments in bash, fish and zsh.
function(dfr_install_completions program component)
  install(FILES ${PROJECT_SOURCE_DIR}/cmake/completion.bash RENAME ${program}
    DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions COMPONENT ${component})
  install(FILES ${PROJECT_SOURCE_DIR}/cmake/completion.fish RENAME ${program}.fish
    DESTINATION ${CMAKE_INSTALL_DATADIR}/fish/vendor_completions.d COMPONENT ${component})
  install(FILES ${PROJECT_SOURCE_DIR}/cmake/completion.zsh RENAME _${program}
    DESTINATION ${CMAKE_INSTALL_DATADIR}/zsh/vendor-completions COMPONENT ${component})
endfunction()

# dfr_add_app(pusher SOURCES ... LINK ...) makes bin/pusher, its manual page and its completion in bash, fish
# and zsh.
function(dfr_add_app name)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "" "SOURCES;LINK")
  add_executable(${name} ${arg_SOURCES})
  target_compile_features(${name} PRIVATE cxx_std_20)
  target_include_directories(${name} PRIVATE ${PROJECT_SOURCE_DIR})
  target_link_libraries(${name} PRIVATE ${arg_LINK} dfr_build_flags)
  dfr_use_precompiled(${name} command_line)
  install(TARGETS ${name} RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT ${name})
  set(manual ${PROJECT_BINARY_DIR}/man/${name}.1)
  add_custom_command(OUTPUT ${manual} DEPENDS ${name}
    COMMAND ${CMAKE_COMMAND} -DPROGRAM=$<TARGET_FILE:${name}> -DNAME=${name}
      -DVERSION=${PROJECT_VERSION} -DOUTPUT=${manual} -P ${PROJECT_SOURCE_DIR}/cmake/ManPage.cmake
    COMMENT "Writing the manual page of ${name}")
  add_custom_target(${name}_manual ALL DEPENDS ${manual})
  if(DFR_QUICK AND DFR_BUILD_TESTS)  # only an installation needs all pages
    dfr_build_with_tier(system ${name}_manual)
  endif()
  install(FILES ${manual} DESTINATION ${CMAKE_INSTALL_MANDIR}/man1 COMPONENT ${name})
  dfr_install_completions(${name} ${name})
  set_property(GLOBAL APPEND PROPERTY DFR_APPS ${name})
endfunction()

# dfr_embed(dfr_sim_pusher models/pusher.xml) embeds the text of each file in the target. The generated
# pusher.xml.h, which only this target can include, defines the text as dfr::embedded::kPusherXml.
function(dfr_embed target)
  set(directory ${CMAKE_CURRENT_BINARY_DIR}/embedded)
  target_include_directories(${target} PRIVATE ${directory})
  foreach(file IN LISTS ARGN)
    set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${file})
    get_filename_component(name ${file} NAME)
    string(REGEX REPLACE "[._]" ";" words ${name})
    set(constant k)
    foreach(word IN LISTS words)
      string(SUBSTRING ${word} 0 1 initial)
      string(TOUPPER ${initial} initial)
      string(SUBSTRING ${word} 1 -1 rest)
      string(APPEND constant ${initial}${rest})
    endforeach()
    file(READ ${file} text)
    file(CONFIGURE OUTPUT ${directory}/${name}.h @ONLY CONTENT [[
// Generated from @file@.
#pragma once
#include <string_view>

namespace dfr::embedded {

constexpr std::string_view @constant@ = R"embedded(@text@)embedded";

}  // namespace dfr::embedded
]])
  endforeach()
endfunction()

# dfr_add_bench(decision_bench LINK dfr::kernel ...) makes bin/decision_bench. A test runs it once,
# untimed.
function(dfr_add_bench name)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "" "SOURCES;LINK")
  if(NOT arg_SOURCES)
    set(arg_SOURCES ${name}.cc)
  endif()
  add_executable(${name} ${arg_SOURCES})
  target_compile_features(${name} PRIVATE cxx_std_20)
  target_link_libraries(${name} PRIVATE ${arg_LINK} benchmark::benchmark dfr_build_flags)
  if(DFR_BUILD_TESTS)
    dfr_add_command_test(${name}.smoke TIER system COMMAND ${name} --benchmark_min_time=0)
  endif()
endfunction()

# dfr_add_peer(mlp_bench_peer SOURCES eigen_mlp.cc LINK Eigen3::Eigen) compiles a benchmark's peer, whose
# library consists of headers, for the instruction set of this machine. Our libraries choose theirs at run
# time. The peer is a shared library that exports only its own functions: a template of Eigen that is compiled
# for another instruction set must not replace the peer's. GCC 12 warns falsely about its own AVX-512 functions.
function(dfr_add_peer name)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "" "SOURCES;LINK")
  add_library(${name} SHARED ${arg_SOURCES})
  set_target_properties(${name} PROPERTIES
    CXX_VISIBILITY_PRESET hidden VISIBILITY_INLINES_HIDDEN ON DISABLE_PRECOMPILE_HEADERS ON)
  target_compile_features(${name} PUBLIC cxx_std_20)
  target_compile_options(${name} PRIVATE -march=native -Wno-uninitialized -Wno-maybe-uninitialized)
  target_include_directories(${name} PUBLIC ${PROJECT_SOURCE_DIR})
  target_link_libraries(${name} PRIVATE ${arg_LINK} dfr_build_flags)
  target_link_options(${name} PRIVATE -Wl,--exclude-libs,ALL)
endfunction()

# Installs the files that find_package(dfr COMPONENTS ...) reads. They name every component of components.txt:
# other builds may install more components into the same folder.
function(dfr_install_package)
  include(DfrMujoco)
  set(libraries ${component_names})
  set(needs "")
  foreach(name IN LISTS libraries)
    string(APPEND needs "set(dfr_${name}_needs ${component_${name}_needs})\n")
  endforeach()
  set(destination ${CMAKE_INSTALL_LIBDIR}/cmake/dfr)
  configure_package_config_file(${PROJECT_SOURCE_DIR}/cmake/dfrConfig.cmake.in
    ${PROJECT_BINARY_DIR}/dfrConfig.cmake INSTALL_DESTINATION ${destination})
  write_basic_package_version_file(${PROJECT_BINARY_DIR}/dfrConfigVersion.cmake
    COMPATIBILITY SameMinorVersion)
  install(FILES ${PROJECT_BINARY_DIR}/dfrConfig.cmake ${PROJECT_BINARY_DIR}/dfrConfigVersion.cmake
    DESTINATION ${destination} COMPONENT core)
endfunction()
