# Included right after project() of every interface package: of the generators of ROS 2, use those
# that rclpy with rmw_fastrtps_cpp loads. Code for C++ nodes would be half of the build. What C
# introspection says goes into the description of every topic's type: without it no publisher.
find_package(rosidl_default_generators REQUIRED)
list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:")

# What is left in C++ consists of headers: several files are compiled as one. Deferred, because
# the package makes the targets later.
cmake_language(DEFER CALL set_target_properties
  ${PROJECT_NAME}__rosidl_typesupport_fastrtps_c ${PROJECT_NAME}__rosidl_typesupport_c
  PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 11)
