"""What tests share: slow twins, clouds, files, clusters and browsers."""
