# Makes dfr_cyclone_types, a C library with the ROS 2 types of dfr::dds for Cyclone DDS. Tests and benchmarks
# use it as an independent implementation of DDS. A macro, because a function must not enable a language.
macro(dfr_cyclone_types)
  find_package(CycloneDDS REQUIRED)
  if(NOT TARGET dfr_cyclone_types)
    find_program(IDLC idlc REQUIRED)
    enable_language(C)
    set(idl ${PROJECT_SOURCE_DIR}/libs/dds/idl/ros2_types.idl)
    set(generated ${PROJECT_BINARY_DIR}/cyclone)
    file(MAKE_DIRECTORY ${generated})
    add_custom_command(OUTPUT ${generated}/ros2_types.c ${generated}/ros2_types.h
      COMMAND ${IDLC} -l c ${idl} DEPENDS ${idl} WORKING_DIRECTORY ${generated} VERBATIM)
    add_library(dfr_cyclone_types STATIC ${generated}/ros2_types.c ${generated}/ros2_types.h)
    target_include_directories(dfr_cyclone_types SYSTEM INTERFACE ${generated})
    target_link_libraries(dfr_cyclone_types PUBLIC CycloneDDS::ddsc)
    set_target_properties(dfr_cyclone_types PROPERTIES POSITION_INDEPENDENT_CODE ON)
    add_dependencies(dfr_generated dfr_cyclone_types)
  endif()
endmacro()
