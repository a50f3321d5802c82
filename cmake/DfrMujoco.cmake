# Minor version of MuJoCo on which the simulations are calibrated. dfrConfig.cmake accepts no other.
set(DFR_MUJOCO_VERSION 2.2)

# Finds MuJoCo for the folders of sim/. Any of these folders may be configured first.
macro(dfr_find_mujoco)
  dfr_find_package(mujoco ${DFR_MUJOCO_VERSION})
  if(NOT "${mujoco_VERSION}." MATCHES "^${DFR_MUJOCO_VERSION}[.]")
    set(DFR_MISSING "package mujoco ${DFR_MUJOCO_VERSION} (there is ${mujoco_VERSION})" PARENT_SCOPE)
    return()
  endif()
  get_target_property(mujoco_is_global mujoco::mujoco IMPORTED_GLOBAL)
  if(NOT mujoco_is_global)
    # Debian's target names the folder of Qhull's headers. This folder is not needed here, and may be
    # absent because Debian's package does not depend on Qhull's.
    get_target_property(mujoco_include_dirs mujoco::mujoco INTERFACE_INCLUDE_DIRECTORIES)
    list(FILTER mujoco_include_dirs EXCLUDE REGEX "qhull")
    set_target_properties(mujoco::mujoco PROPERTIES
      INTERFACE_INCLUDE_DIRECTORIES "${mujoco_include_dirs}" IMPORTED_GLOBAL TRUE)
  endif()
endmacro()
