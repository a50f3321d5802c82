# cpack runs this script before it makes the packages. The script copies /usr/share/doc/<package>/copyright of each
# Debian package that a component is built with into the component's package.
foreach(component IN LISTS CPACK_COMPONENTS_ALL)
  string(TOUPPER ${component} id)
  set(folder ${CPACK_TEMPORARY_DIRECTORY}/${component}${CPACK_PACKAGING_INSTALL_PREFIX}/share/doc)
  foreach(package IN LISTS CPACK_DFR_${id}_BUILT_WITH)
    set(text /usr/share/doc/${package}/copyright)
    if(NOT EXISTS ${text})
      message(FATAL_ERROR "${text} is missing: ${component} is built with ${package}, so the package of "
                          "${component} must include this licence. Install ${package} with its documentation")
    endif()
    configure_file(${text} ${folder}/${CPACK_DEBIAN_${id}_PACKAGE_NAME}/third_party/${package}/copyright
      COPYONLY)
  endforeach()
endforeach()
