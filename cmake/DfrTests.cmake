# Tests and their tiers. Each test has one tier, which is its label in CTest:
#   unit         fakes only: no sleep, no socket, no process, no clock of the machine
#   integration  DDS on the loopback, pseudo-terminals, Python, programs run as programs
#   system       real time, killed processes, whole studies, packages, browsers, npm
#   repository   licences, documents, figures, prose
# ./dev test runs all tiers except system. ./dev test --all runs all tiers.

# The target "system" builds the targets that only tests of the tier system need; "all" excludes them.
add_custom_target(system)

find_package(GTest REQUIRED)
include(GoogleTest)
find_program(DFR_PYTHON python3 PATHS /usr/bin NO_DEFAULT_PATH REQUIRED)
dfr_add_precompiled(test <gmock/gmock.h> <gtest/gtest.h>)
if(DFR_PRECOMPILE)
  target_link_libraries(dfr_precompiled_test PRIVATE GTest::gmock)
endif()

# dfr_add_tests(kernel SOURCES one_class_svm_test.cc ... [TIER integration] [LINK dfr::kernel ...]
#               [INCLUDE libs/kernel/src ...] [DEFINE NAME=value ...] [NEEDS program ...] [TIMEOUT seconds])
# makes one program of all tests of a tier in a folder and its subfolders. The program is one CTest case, such
# as unit.kernel, and runs its tests in random order. In the tier integration, each TEST is a separate case,
# such as dds.Suite.Name. testing::TempDir() is in the build tree, so two trees can be tested at once.
function(dfr_add_tests name)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "TIER;TIMEOUT" "SOURCES;LINK;INCLUDE;DEFINE;NEEDS")
  if(NOT arg_TIER)
    set(arg_TIER unit)
  endif()
  if(NOT arg_TIMEOUT)
    set(arg_TIMEOUT 900)
  endif()
  set(target ${name}_${arg_TIER}_tests)
  add_executable(${target} ${arg_SOURCES})
  set_target_properties(${target} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/tests)
  target_compile_features(${target} PRIVATE cxx_std_20)
  list(TRANSFORM arg_INCLUDE PREPEND ${PROJECT_SOURCE_DIR}/)
  target_include_directories(${target} PRIVATE ${arg_INCLUDE})
  target_compile_definitions(${target} PRIVATE ${arg_DEFINE})
  target_link_libraries(${target} PRIVATE ${arg_LINK} dfr_test_support GTest::gmock GTest::gtest_main
    dfr_build_flags)
  dfr_use_precompiled(${target} test)
  dfr_build_with_tier(${arg_TIER} ${target})
  if(arg_NEEDS)
    add_dependencies(${target} ${arg_NEEDS})
  endif()
  set(folder ${PROJECT_BINARY_DIR}/tests/tmp)
  file(MAKE_DIRECTORY ${folder})
  if(arg_TIER STREQUAL "integration")
    gtest_discover_tests(${target} TEST_PREFIX ${name}. DISCOVERY_TIMEOUT 600
      PROPERTIES TIMEOUT ${arg_TIMEOUT} LABELS integration ENVIRONMENT TEST_TMPDIR=${folder})
  else()
    add_test(NAME ${arg_TIER}.${name} COMMAND ${target})
    set_tests_properties(${arg_TIER}.${name} PROPERTIES
      TIMEOUT ${arg_TIMEOUT} LABELS ${arg_TIER} ENVIRONMENT "GTEST_SHUFFLE=1;TEST_TMPDIR=${folder}")
    if(arg_TIER STREQUAL "system")  # tests in real time run alone
      set_tests_properties(system.${name} PROPERTIES RUN_SERIAL ON)
    endif()
  endif()
endfunction()

# dfr_add_command_test(guard.report TIER integration COMMAND ... [TIMEOUT seconds] [PROPERTIES name value ...])
function(dfr_add_command_test name)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "TIER;TIMEOUT;WORKING_DIRECTORY" "COMMAND;PROPERTIES")
  if(NOT arg_TIMEOUT)
    set(arg_TIMEOUT 900)
  endif()
  if(NOT arg_WORKING_DIRECTORY)
    set(arg_WORKING_DIRECTORY ${CMAKE_CURRENT_BINARY_DIR})
  endif()
  add_test(NAME ${name} COMMAND ${arg_COMMAND} WORKING_DIRECTORY ${arg_WORKING_DIRECTORY})
  set_tests_properties(${name} PROPERTIES TIMEOUT ${arg_TIMEOUT} LABELS ${arg_TIER} ${arg_PROPERTIES})
endfunction()

# dfr_build_with_tier(tier target ...) excludes the targets from "all" if the tier is system.
function(dfr_build_with_tier tier)
  if(tier STREQUAL "system")
    set_target_properties(${ARGN} PROPERTIES EXCLUDE_FROM_ALL ON)
    add_dependencies(system ${ARGN})
  endif()
endfunction()
